"""Psychometric curve: share of answers against the stimulus, with lapse and guess rates."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr, ndtri, xlog1py, xlogy

from fingerflow.models.observer.estimate import UNKNOWN, Interval, Values, jackknife

#: Guess rate by the design of the experiment. In a forced choice between two intervals a participant who feels no
#: difference is right half of the time. The share of "yes" without a stimulus is the participant's own and is fitted.
FORCED_CHOICE, YES_NO = "forced choice", "yes/no"
GUESSES = {FORCED_CHOICE: 0.5, YES_NO: None}
SHARE = 0.75  # of answers at the threshold
_FEWEST_STIMULI = 3
# Bounds of a and b of Phi(a + b x), x in ranges of the stimuli, and of the fitted lapse and guess rates.
_BOUNDS = ((-1e4, 1e4), (-200.0, 200.0), (0.0, 0.24), (0.0, 0.5))
_STARTS = 0.1, 0.5, 0.9  # quantiles of the stimuli
_STEPS, _LEAST_GAIN = 50, 1e-9  # of the fit
_PRIOR = 9.0  # Beta(1, 10) of both rates, (1 - rate)^9 (Schuett et al. 2016): lapses and guesses are probably few


@dataclass(frozen=True)
class PsychometricFit:
    """Psychometric curve fitted by `fit_psychometric`; NaN for parameters that the data leave open.

    Attributes:
        trials: number of answers.
        threshold: the stimulus at which three quarters of the answers are of the counted kind, with its `interval`.
        width: standard deviation of the Gaussian core, in the stimulus' unit; negative for a falling curve.
        guess, lapse: share of answers at the lower asymptote, and 1 minus the share at the upper one.
        reason: why a number is NaN; empty otherwise.
    """

    trials: int
    threshold: float = math.nan
    interval: Interval = UNKNOWN
    width: float = math.nan
    guess: float = math.nan
    lapse: float = math.nan
    reason: str = ""

    def __call__(self, stimulus: ArrayLike) -> Values:
        """Return the share of answers, 0 to 1, that the fitted psychometric curve predicts at stimuli of any shape."""
        return _curve(np.asarray(stimulus, dtype=np.float64), self.threshold, 1 / self.width, self.guess, self.lapse)


def fit_psychometric(
    stimulus: ArrayLike, answers: ArrayLike, trials: ArrayLike, participants: ArrayLike, guess: float | None = None
) -> PsychometricFit:
    """Fit a curve P(x) = guess + (1 - guess - lapse) Phi((x - middle) / width) to counts of answers at stimuli x.

    The fit maximises the binomial likelihood, with weak priors on lapse and guess. Blocks of one participant share a
    threshold of their own, and differ by more than chance, because attention varies: the interval of the threshold is
    that of Student's t by the jackknife over participants.

    Args:
        stimulus: (K,) of each block of trials; a stimulus may come in several blocks.
        answers: (K,) number of answers of the counted kind, as "the comparison is more slippery".
        trials: (K,) number of trials, 1 at least.
        participants: (K,) of the blocks.
        guess: `GUESSES` of the design: 0.5 of a forced choice between two intervals; None, fitted, of yes and no.

    Returns:
        `PsychometricFit`; NaN with the reason where there are fewer than three stimuli or the answers do not change.

    Raises:
        ValueError: values that are not valid counts, or lengths that differ.
    """
    x, yes, number = (np.asarray(values, dtype=np.float64).reshape(-1) for values in (stimulus, answers, trials))
    who = np.asarray(participants).reshape(-1)
    if len({x.size, yes.size, number.size, who.size}) > 1:
        raise ValueError(
            f"{x.size} stimuli, {yes.size} answers, {number.size} trials, {who.size} participants: not alike"
        )
    if not (np.isfinite(x).all() and ((yes >= 0) & (yes <= number) & (number >= 1)).all()):
        raise ValueError("answers go from 0 to the trials, trials from 1, and stimuli are finite: leave out the others")
    nothing = PsychometricFit(int(number.sum()))
    if np.unique(x).size < _FEWEST_STIMULI:
        return replace(nothing, reason=f"{np.unique(x).size} stimuli: {_FEWEST_STIMULI} are needed")
    if yes.sum() in (0, number.sum()):
        return replace(nothing, reason=f"all answers are the same: {int(yes.sum())} of {nothing.trials} are counted")
    origin, unit = float(np.median(x)), float(np.ptp(x))
    stimuli, column = np.unique((x - origin) / unit, return_inverse=True)
    people, row = np.unique(who, return_inverse=True)
    # (2, P + 1, S) answers and trials at each stimulus: of all participants, and without each of them.
    counts = np.zeros((2, people.size + 1, stimuli.size))
    for table, values in zip(counts, (yes, number), strict=True):
        np.add.at(table, (row + 1, column), values)
    counts = counts.sum(1, keepdims=True) - counts
    offset, slope, lapse, guesses = _most_likely(stimuli, counts[0], counts[1], guess).T
    if (1 - guesses[0] - lapse[0]) * np.ptp(ndtr(offset[0] + slope[0] * stimuli)) <= 0.01:
        return replace(
            nothing, reason="the answers do not change with the stimulus: no width is better than an infinite one"
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        thresholds = (ndtri((SHARE - guesses) / (1 - guesses - lapse)) - offset) / slope
    interval, _, reason = jackknife(thresholds[0], thresholds[1:])
    threshold, low, high = (float(origin + unit * value) for value in (thresholds[0], *interval))
    numbers = float(unit / slope[0]), float(guesses[0]), float(lapse[0])
    return PsychometricFit(nothing.trials, threshold, (low, high), *numbers, reason)


def _most_likely(x: Values, yes: Values, number: Values, guess: float | None) -> Values:
    """Return the parameters (B, 4) a, b, lapse and guess of curves guess + (1 - guess - lapse) Phi(a + b x) that
    maximise likelihood times prior of B samples of answers (B, S), of numbers of trials (B, S), at stimuli (S,).

    Steps are Fisher's scoring with Levenberg's damping, from curves whose middle is at three quantiles of the stimuli.
    """
    low, high = np.array(_BOUNDS if guess is None else (*_BOUNDS[:3], (guess, guess))).T
    slope = math.copysign(4.0, (x - x.mean()) @ (yes[0] / number[0] - yes[0].mean() / number[0].mean()))
    starts = [(-slope * middle, slope, 0.02, 0.02) for middle in np.quantile(x, _STARTS)]
    values = np.repeat(np.clip(starts, low, high)[:, None], len(yes), axis=1)
    damping, diagonal = np.full(values.shape[:2], 1e-3), np.eye(4, dtype=bool)

    def predicted(values: Values) -> tuple[Values, Values, Values]:
        offset, slope, lapse, rate = np.moveaxis(values[..., None], 2, 0)
        core = offset + slope * x
        share = (rate + (1 - rate - lapse) * ndtr(core)).clip(1e-12, 1 - 1e-12)
        binomial = (xlogy(yes, share) + xlog1py(number - yes, -share)).sum(-1)
        return core, share, binomial + _PRIOR * np.log1p(-values[..., 2:]).sum(-1)

    for _ in range(_STEPS):
        core, share, best = predicted(values)
        density = (1 - values[..., 2:].sum(-1, keepdims=True)) * np.exp(-(core**2) / 2) / math.sqrt(2 * math.pi)
        slopes = np.stack((density, density * x, -ndtr(core), ndtr(-core)), axis=-2)
        weighted = slopes / (share * (1 - share))[..., None, :]
        score = (weighted @ (yes - number * share)[..., None])[..., 0]
        score[..., 2:] -= _PRIOR / (1 - values[..., 2:])
        free = (values > low) & (score < 0) | (values < high) & (score > 0)
        information = (weighted * number[:, None]) @ slopes.swapaxes(-1, -2)
        information += diagonal * (information * damping[..., None, None] + 1e-9)
        information = np.where(free[..., None] & free[..., None, :], information, diagonal)
        moved = (values + np.linalg.solve(information, (free * score)[..., None])[..., 0]).clip(low, high)
        gain = predicted(moved)[2] - best
        values = np.where(gain[..., None] > 0, moved, values)
        damping = np.where(gain > 0, damping / 10, damping * 10)
        if np.abs(gain).max() < _LEAST_GAIN:
            break
    return np.take_along_axis(values, predicted(values)[2].argmax(0)[None, :, None], axis=0)[0]


def _curve(x: Values, threshold: float, slope: float, guess: float, lapse: float) -> Values:
    height = 1 - guess - lapse
    return guess + height * ndtr((x - threshold) * slope + ndtri((SHARE - guess) / height))
