"""Laws by which contact and friction grow with force and with time, fitted with their standard deviations."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Law(NamedTuple):
    """Fitted law y = factor x^exponent, or y = limit + step exp(-t / time) with `exponent` as its time (s), and the
    standard deviation of the exponent; NaN where it cannot be fitted.
    """

    factor: float
    exponent: float
    exponent_std: float


_NONE = Law(np.nan, np.nan, np.nan)


def power_law(x: NDArray[np.float64], y: NDArray[np.float64], group: NDArray[np.generic]) -> Law:
    """Fit y = k x^n to positive values (N,) by least squares of the logarithms; others are left out.

    The area of a fingertip grows with 0.3 to 0.7 of the force (Dzidek et al. 2017), and friction is k N^(n - 1) (Adams
    et al. 2013). Values of a `group` (N,), such as the trials of a participant or a tenth of a press, share errors: the
    standard deviation is that of leaving out a group at a time (jackknife), of which three are needed.
    """
    x, y = (np.asarray(values, dtype=np.float64) for values in (x, y))
    counts = (x > 0) & (y > 0)
    names = np.unique(group[counts])
    if names.size < 3 or np.ptp(x[counts]) == 0:
        return _NONE
    across, up, of_group = np.log(x[counts]), np.log(y[counts]), group[counts]

    def slope(kept: NDArray[np.bool_]) -> float:
        apart = across[kept] - across[kept].mean()
        return float(apart @ up[kept] / (apart @ apart)) if apart.any() else np.nan

    exponent = slope(np.ones(across.size, bool))
    left_out = np.array([slope(of_group != name) for name in names])
    deviation = float(np.sqrt((names.size - 1) * np.mean((left_out - left_out.mean()) ** 2)))
    return Law(float(np.exp((up - exponent * across).mean())), exponent, deviation)


def relaxation(time: NDArray[np.float64], values: NDArray[np.float64]) -> Law:
    """Fit a + b exp(-t / tau) to values (N,) at times (N,) s, with errors that are independent from time to time; the
    factor is b.

    The contact of a fingertip that is held at a force grows so, as moisture softens the skin (Dzidek et al. 2017). NaN
    where tau is longer than the time that was recorded or not known to a half, or b is under three deviations: then no
    such growth was seen.
    """
    from scipy.optimize import curve_fit

    time, values = (np.asarray(one, dtype=np.float64) for one in (time, values))
    known = np.isfinite(values)
    if known.sum() < 5:
        return _NONE
    since, span = time[known] - time[known][0], float(np.ptp(time[known]))
    start = values[known][-1], values[known][0] - values[known][-1], span / 3
    try:
        fit, covariance = curve_fit(lambda t, a, b, tau: a + b * np.exp(-t / tau), since, values[known], start,
                                    bounds=((-np.inf, -np.inf, span / 1e3), np.inf), gtol=None)  # fmt: skip
    except RuntimeError:  # no convergence
        return _NONE
    (_, step, tau), (_, step_std, deviation) = fit.tolist(), np.sqrt(np.diag(covariance)).tolist()
    seen = abs(step) > 3 * step_std and tau < span and deviation < tau / 2
    return Law(step, tau, deviation) if seen else _NONE
