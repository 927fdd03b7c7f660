"""Psychometric curve: share of answers against the stimulus, with lapse and guess rates."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.special import ndtr, ndtri, xlog1py, xlogy

from fingerflow.models.observer.estimate import UNKNOWN, Interval, Values, jackknife

#: Guess rate by the design of the experiment. In a forced choice between two intervals a participant who feels no
#: difference is right half of the time. The share of "yes" without a stimulus is the participant's own and is fitted.
FORCED_CHOICE, YES_NO = "forced choice", "yes/no"
GUESSES = {FORCED_CHOICE: 0.5, YES_NO: None}
SHARE = 0.75  # of answers at the threshold
_FEWEST_STIMULI = 3
# Bounds of threshold and slope, in ranges of the stimuli, and of the fitted lapse and guess rates.
_BOUNDS = ((-50.0, 50.0), (-200.0, 200.0), (0.0, 0.24), (0.0, 0.5))
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
        x = np.asarray(stimulus, dtype=np.float64)
        return _curve(x, self.threshold, 1 / self.width, self.guess, self.lapse)


def fit_psychometric(
    stimulus: ArrayLike,
    answers: ArrayLike,
    trials: ArrayLike,
    participants: ArrayLike,
    guess: float | None = None,
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
    x = (x - origin) / unit

    def loss(values: Values, used: NDArray[np.bool_]) -> float:
        threshold, slope, lapse, guesses = (*values, guess)[:4]
        expected = np.clip(_curve(x[used], threshold, slope, guesses, lapse), 1e-12, 1 - 1e-12)
        likelihood = (xlogy(yes[used], expected) + xlog1py((number - yes)[used], -expected)).sum()
        return -float(likelihood + _PRIOR * sum(math.log1p(-rate) for rate in values[2:]))

    def minimised(start: Values, used: NDArray[np.bool_]) -> tuple[float, Values]:
        result = minimize(loss, start, used, method="L-BFGS-B", bounds=_BOUNDS[: start.size])
        return float(result.fun), result.x

    all_blocks = np.ones(x.size, dtype=bool)
    rates = (0.02,) if guess is not None else (0.02, 0.02)
    rising = 4.0 if ((x - x.mean()) * (yes / number - yes.sum() / number.sum())).sum() > 0 else -4.0
    starts = (np.array([threshold, rising, *rates]) for threshold in np.quantile(x, (0.1, 0.5, 0.9)))
    _, best = min((minimised(start, all_blocks) for start in starts), key=lambda pair: pair[0])
    threshold, slope, lapse, guesses = (*best.tolist(), guess)[:4]
    if abs(float(np.ptp(_curve(np.array([x.min(), x.max()]), threshold, slope, guesses, lapse)))) <= 0.01:
        return replace(
            nothing, reason="the answers do not change with the stimulus: no width is better than an infinite one"
        )
    interval, _, reason = jackknife(threshold, [minimised(best, who != name)[1][0] for name in np.unique(who)])
    low, high = (origin + unit * limit for limit in interval)
    return PsychometricFit(nothing.trials, origin + unit * threshold, (low, high), unit / slope, guesses, lapse, reason)


def _curve(x: Values, threshold: float, slope: float, guess: float, lapse: float) -> Values:
    height = 1 - guess - lapse
    return np.asarray(guess + height * ndtr((x - threshold) * slope + ndtri((SHARE - guess) / height)))
