"""Psychometric curve: share of answers against the stimulus, with lapse and guess rates and overdispersion."""

import math
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq, minimize
from scipy.special import betaln, expit, logit, logsumexp, ndtr, ndtri, xlog1py, xlogy
from scipy.stats import chi2

from fingerflow.models.observer.estimate import UNKNOWN, Interval
from fingerflow.models.observer.jackknife import jackknife_interval

Values = NDArray[np.float64]

#: Guess rate by the design of the experiment. In a forced choice between two intervals a participant who feels no
#: difference is right half of the time. The share of "yes" without a stimulus is the participant's own and is fitted.
FORCED_CHOICE, YES_NO = "forced choice", "yes/no"
GUESSES = {FORCED_CHOICE: 0.5, YES_NO: None}
_FEWEST_STIMULI = 3
_LARGEST_RATE = 0.5  # upper bound of the fitted lapse and guess rates
_RATE_PRIOR = (1.0, 10.0)  # Beta distribution (Schuett et al. 2016), under which lapses and guesses are probably few
# Overdispersion is integrated with a uniform prior on its square root, up to (0.8)^2: the Beta(1, 10) of the same
# authors makes intervals of few blocks too short (measured: coverage 0.77 instead of 0.95, with 0.05 in the data).
_SPREADS: Values = ((np.arange(24) + 0.5) / 30) ** 2
# Bounds, in ranges of the stimuli: a threshold beyond the first counts as infinite; the second bounds the slope.
_FURTHEST, _STEEPEST = 50.0, 200.0
_STARTS = 4  # number of grid points from which the search starts
_LOGIT = 15.0  # bound of the logits of the rates, which is a rate of 3e-7


@dataclass(frozen=True)
class PsychometricFit:
    """Psychometric curve fitted by `fit_psychometric`, with intervals; NaN for parameters that the data leave open.

    Attributes:
        threshold: the stimulus at which the share of answers is `share`; its `interval` at `level` contains it, and a
            limit that the data do not determine is infinite.
        width: standard deviation of the Gaussian core, in the stimulus' unit; negative for a falling curve.
        guess, lapse: share of answers at the lower asymptote, and 1 minus the share at the upper one.
        overdispersion: 0 where answers are independent, towards 1 where all answers of a block agree.
        trials: number of answers; `stimuli`, number of different stimuli.
        share, level: as requested.
        reason: why a number is NaN; empty otherwise.
    """

    threshold: float
    interval: Interval
    width: float
    guess: float
    lapse: float
    overdispersion: float
    trials: int
    stimuli: int
    share: float
    level: float
    reason: str

    def __call__(self, stimulus: ArrayLike) -> Values:
        """Return the share of answers, 0 to 1, that the fitted psychometric curve predicts at stimuli of any shape."""
        x = np.asarray(stimulus, dtype=np.float64)
        middle = self.threshold - self.width * _core(self.share, self.guess, self.lapse)
        return np.asarray(self.guess + (1 - self.guess - self.lapse) * ndtr((x - middle) / self.width))


def fit_psychometric(
    stimulus: ArrayLike,
    answers: ArrayLike,
    trials: ArrayLike,
    share: float = 0.75,
    guess: float | None = None,
    level: float = 0.95,
    participants: ArrayLike | None = None,
) -> PsychometricFit:
    """Fit a curve P(x) = guess + (1 - guess - lapse) Phi((x - middle) / width) to counts of answers at stimuli x.

    Counts follow a beta-binomial distribution: blocks of trials at one stimulus differ by more than chance, because
    attention varies. The fit maximises the posterior, with weak priors on lapse and guess and the overdispersion
    integrated out. The interval of the threshold holds every threshold whose profile of that posterior is within
    chi^2 / 2 of the maximum, so it contains the estimate. Blocks of one participant share a threshold of their own:
    with participants the interval is Student's, by the jackknife over them.

    Args:
        stimulus: (K,) of each block of trials; a stimulus may come in several blocks.
        answers: (K,) number of answers of the counted kind, as "the comparison is more slippery".
        trials: (K,) number of trials, 1 at least.
        share: of answers at the threshold.
        guess: `GUESSES` of the design: 0.5 of a forced choice between two intervals; None, fitted, of yes and no.
        level: of the interval.
        participants: (K,) of the blocks; blocks are independent where None.

    Returns:
        `PsychometricFit`; NaN with the reason where there are fewer than three stimuli or the answers do not change.

    Raises:
        ValueError: values that are not valid counts, lengths that differ, or share, guess or level out of range.
    """
    x, yes, number = _check_counts(stimulus, answers, trials)
    lowest = 0.0 if guess is None else guess
    if not 0 <= lowest < share < 1:
        raise ValueError(f"the share is {share:g} and guesses {lowest:g}: give a share between the guesses and 1")
    if not 0 < level < 1:
        raise ValueError(f"the level is {level:g}: give one between 0 and 1, as 0.95")
    stimuli, count = np.unique(x).size, int(number.sum())

    def nothing(reason: str) -> PsychometricFit:
        nan = math.nan
        return PsychometricFit(nan, UNKNOWN, nan, nan, nan, nan, count, stimuli, share, level, reason)

    if stimuli < _FEWEST_STIMULI:
        return nothing(f"{stimuli} stimuli: {_FEWEST_STIMULI} are needed")
    if yes.sum() in (0, count):
        return nothing(f"all answers are the same: {int(yes.sum())} of {count} are of the kind that counts")
    posterior = _Posterior(x, yes, number, share, guess)
    best = posterior.best()
    threshold, width, fitted_guess, lapse = posterior.parameters(best)
    if not posterior.rises(best):
        return nothing("the answers do not change with the stimulus: no width is better than an infinite one")
    reason = ""
    if participants is None:
        allowed = posterior(best) + float(chi2.ppf(level, 1)) / 2
        profile = posterior.profile(best)
        low, high = (_limit(profile, best[0], allowed, side) for side in (-1, 1))
        interval = posterior.origin + posterior.unit * low, posterior.origin + posterior.unit * high
    else:
        who = np.asarray(participants).reshape(-1)
        if who.size != x.size:
            raise ValueError(f"{who.size} participants of {x.size} blocks: name that of every block")
        without = [posterior.threshold_of(who != name, best) for name in np.unique(who)]
        interval, _, reason = jackknife_interval(threshold, without, level)
    curve = threshold, interval, width, fitted_guess, lapse, posterior.overdispersion(best)
    return PsychometricFit(*curve, count, stimuli, share, level, reason)


class _Posterior:
    """Negative log posterior of a psychometric curve's threshold, slope, lapse and guess rate; overdispersion is
    integrated out.

    At the joint mode the overdispersion of few blocks is mostly 0 and intervals are too short. Stimuli are
    scaled to about unit range; the slope 1 / width may have either sign; the rates are in logits.
    """

    def __init__(self, x: Values, yes: Values, number: Values, share: float, guess: float | None) -> None:
        self.origin, self.unit = float(np.median(x)), float(np.ptp(x))
        self.x, self.yes, self.number = (x - self.origin) / self.unit, yes, number
        self.share, self.fixed = share, guess

    def __call__(self, values: Values) -> float:
        _, _, guess, lapse = self._natural(values)
        if not guess < self.share < 1 - lapse:
            return 1e10
        prior = _log_beta(lapse, *_RATE_PRIOR) + (_log_beta(guess, *_RATE_PRIOR) if self.fixed is None else 0.0)
        return -float(logsumexp(self._log_likelihoods(values)) + prior)

    def overdispersion(self, values: Values) -> float:
        """Return the posterior mean of the overdispersion, 0 (chance alone) to 1: the correlation of answers within a
        block of trials, for given curve parameters `values`.
        """
        log = self._log_likelihoods(values)
        return float(_SPREADS @ np.exp(log - logsumexp(log)))

    def _log_likelihoods(self, values: Values) -> Values:
        """Return the log likelihood (24,) of the answers for given curve parameters `values`, at each overdispersion
        (correlation of answers within a block) of the grid `_SPREADS`, up to a constant.
        """
        expected = self._expected(values)
        # Beta-binomial distribution with mean p and a + b = 1 / spread - 1; terms independent of the parameters are
        # left out.
        total = 1 / _SPREADS[:, None] - 1
        first, second = expected * total, (1 - expected) * total
        likelihood = betaln(self.yes + first, self.number - self.yes + second) - betaln(first, second)
        return np.asarray(likelihood.sum(1))

    def _expected(self, values: Values) -> Values:
        threshold, slope, guess, lapse = self._natural(values)
        core = ndtr((self.x - threshold) * slope + _core(self.share, guess, lapse))
        return np.asarray(np.clip(guess + (1 - guess - lapse) * core, 1e-12, 1 - 1e-12))

    def best(self) -> Values:
        """Return the parameters of the psychometric curve that maximise the posterior, in the scaled units of the fit.

        The posterior may have several peaks, so the search starts from the best points of a grid.
        """
        middles = np.linspace(self.x.min() - 0.5, self.x.max() + 0.5, 9)
        starts = [start for middle in middles for start in self._starts(middle)]
        return min((self._minimised(start, 0) for start in sorted(starts, key=self)[:_STARTS]), key=self)

    def _starts(self, middle: float, threshold: float | None = None) -> list[Values]:
        """Return starting points of the curve fit, one for each of 12 slopes: all have the given threshold, or else the
        given middle (stimulus at which the curve is half-way between its ends).
        """
        rates = [logit(0.04)] * (2 if self.fixed is None else 1)
        guess = 0.02 if self.fixed is None else self.fixed
        core = _core(self.share, guess, 0.02)
        return [
            np.array([middle + core / slope if threshold is None else threshold, slope, *rates])
            for size in (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
            for slope in (size, -size)
        ]

    def threshold_of(self, chosen: NDArray[np.bool_], near: Values) -> float:
        """Fit the curve to a part of the data, the blocks of answers in the mask `chosen`, searching from the
        parameters `near`; return its threshold in the units of the stimulus.
        """
        part = copy(self)
        part.x, part.yes, part.number = self.x[chosen], self.yes[chosen], self.number[chosen]
        return self.parameters(part._minimised(near, 0))[0]

    def rises(self, values: Values) -> bool:
        """Return whether the curve with the parameters `values` changes, up or down, by more than 0.01 over the range
        of the stimuli.
        """
        threshold, slope, guess, lapse = self._natural(values)
        core = ndtr((np.array([self.x.min(), self.x.max()]) - threshold) * slope + _core(self.share, guess, lapse))
        return bool(abs((1 - guess - lapse) * np.diff(core)[0]) > 0.01)

    def parameters(self, values: Values) -> tuple[float, float, float, float]:
        """Return threshold, width, guess and lapse rate of the curve in the units of the data, from the fit's scaled
        parameters `values`.
        """
        threshold, slope, guess, lapse = self._natural(values)
        return self.origin + self.unit * threshold, self.unit / slope, guess, lapse

    def profile(self, best: Values) -> Callable[[float], float]:
        """Return a function of the threshold: the profile of the negative log posterior, minimised over all other
        parameters, with searches that begin from the fitted parameters `best`.

        Each search starts from the solution at the nearest known threshold, and from the best of a grid.
        """
        known = {float(best[0]): (self(best), best[1:])}

        def at(threshold: float) -> float:
            if threshold not in known:
                neighbour = known[min(known, key=lambda other: abs(other - threshold))][1]
                starts = np.append(threshold, neighbour), min(self._starts(0.0, threshold), key=self)
                rest = [self._minimised(start, 1)[1:] for start in starts]
                found = [(self(np.append(threshold, some)), some) for some in rest]
                known[threshold] = min(found, key=lambda pair: pair[0])
            return known[threshold][0]

        return at

    def _minimised(self, start: Values, fixed: int) -> Values:
        """Return curve parameters that minimise the negative log posterior near the parameters `start`; the first
        ``fixed`` of them keep their starting values.
        """
        limits = (_FURTHEST, _STEEPEST, *[_LOGIT] * (start.size - 2))

        def rest(values: Values) -> float:
            return self(np.append(start[:fixed], values))

        found = minimize(rest, start[fixed:], method="L-BFGS-B", bounds=[(-limit, limit) for limit in limits[fixed:]])
        return np.append(start[:fixed], found.x)

    def _natural(self, values: Values) -> tuple[float, float, float, float]:
        lapse = _LARGEST_RATE * expit(values[2])
        guess = _LARGEST_RATE * expit(values[3]) if self.fixed is None else self.fixed
        return float(values[0]), float(values[1]), float(guess), float(lapse)


def _limit(profile: Callable[[float], float], best: float, allowed: float, side: int) -> float:
    """Return one end of the threshold's interval: the threshold above (`side` 1) or below (-1) the best one at which
    the profile of the negative log posterior reaches ``allowed``, or infinity if none does.
    """
    inner, reach = best, 0.05
    while profile(best + side * reach) < allowed:
        inner, reach = best + side * reach, 2 * reach
        if reach > _FURTHEST:
            return side * math.inf
    return float(brentq(lambda threshold: profile(threshold) - allowed, inner, best + side * reach, xtol=2e-3))


def _core(share: float, guess: float, lapse: float) -> float:
    return float(ndtri((share - guess) / (1 - guess - lapse)))


def _log_beta(value: float, first: float, second: float) -> float:
    return float(xlogy(first - 1, value) + xlog1py(second - 1, -value))


def _check_counts(*arrays: ArrayLike) -> tuple[Values, Values, Values]:
    x, yes, number = (np.asarray(values, dtype=np.float64).reshape(-1) for values in arrays)
    if not x.size == yes.size == number.size:
        raise ValueError(f"{x.size} stimuli, {yes.size} counts of answers and {number.size} of trials: give one each")
    if not (np.isfinite(x).all() and ((yes >= 0) & (yes <= number) & (number >= 1)).all()):
        raise ValueError("answers go from 0 to the trials, trials from 1, and stimuli are finite: leave out the others")
    return x, yes, number
