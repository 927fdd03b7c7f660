"""Find when the stuck area collapses: a change point, after which the area no longer follows the load ratio T/N."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

_DEPTH = 0.3  # range of the relative load below its largest value; frames with less load are left out
_AFTER_S = 0.2  # s after the loss of adhesion up to which frames are used
_FEWEST = 8  # least number of frames
_STEP_S = 1 / 60  # s, shortest interval between used frames; faster recordings are subsampled
_ENDS_S = np.arange(-0.1, 0.16, 0.01)  # s after the frame in which adhesion is lost: candidate ends of the collapse
_DURATIONS_S = np.arange(0, 1.001, 0.02)  # s, candidate durations of the collapse
# Candidates for e, the shape of the decay, from a square root (0) to a line.
_BENDS = np.array([0, 0.01, 0.1, 1])[:, None]
_RATE_S = 0.15  # s before the collapse over which the loading rate is measured
_STEADY = 0.01  # standard deviation of T/N from a constant or a ramp, relative
# Candidate relative loads above the last one, at which a fading area would have vanished.
_ABOVE = (0.0, 0.005, 0.01, 0.015)
_AREA_ERROR = 0.006  # least standard deviation of d^2 in a frame, as measured on pictures without visible noise
# RMS errors of area and duration on simulated and rendered trials that the fit's own deviations do not contain.
_AREA_STD = 0.015
_DURATION_STD = 0.01  # s


@dataclass(frozen=True)
class Collapse:
    """Collapse of the stuck area at constant load, as fitted by `fit_collapse`.

    Attributes:
        area: d^2 at which the collapse begins; `area_std`, its standard deviation.
        rate: d^2 per second during the collapse; `rate_std`, its standard deviation.
        duration: s from `area` to none; `duration_std`, its standard deviation.
        begin: s, time at which the collapse begins.
        evidence: chi^2 of an area that fades, less that of one that collapses.
    """

    area: float
    area_std: float
    rate: float
    rate_std: float
    duration: float
    duration_std: float
    begin: float
    evidence: float


def fit_collapse(area: Values, load: Values, time: Values, loss: int) -> Collapse | None:
    """Fit the time at which the stuck area share d^2 (stuck over contact area) of a trial collapses: before it d^2
    follows the load ratio T/N, and afterwards it falls to 0 at constant load.

    With H the largest T/N so far, t_c the change point and D the duration of the collapse,

        d^2 = c + b f(H / H(t_c)),   f(h) = (1 - h + e)^(1/2) - e^(1/2)     up to t_c
        d^2 = c (1 - (t - t_c) / D)                                         from t_c to t_c + D

    The shape before t_c ranges from a square root (e = 0) to a line (e large), so no friction law is assumed. It
    contains equation 5 of Terekhov & Hayward (2011), by which T/N is a parabola in d^2. For each t_c, D and e of a
    grid, c and b follow by least squares, both 0 or more. chi^2 sums the squared residuals of d^2, and of T/N above
    H(t_c), which has a deviation of 1 %. It is reduced by the correlation of residuals from frame to frame. Means and
    deviations are taken over the grid, with weights exp(-chi^2 / 2).

    The alternative is an area that fades: c = 0, and the load continues from t_c to t_c + D at the rate it had
    before, while the measured one is within its deviation of 1 %; so is the load at which the area has faded,
    between two frames. `evidence` is the difference of the least chi^2 of both.

    Args:
        area: (F,) smoothed d^2, NaN where it is not known.
        load: (F,) smoothed T/N, likewise.
        time: (F,) s.
        loss: index of the frame in which d^2 has reached 0.

    Returns:
        None if fewer than eight frames can be used.
    """
    valid = np.isfinite(area) & np.isfinite(load) & (time <= time[loss] + _AFTER_S)
    t, s, highest = time[valid], area[valid], np.maximum.accumulate(load[valid])
    if t.size < _FEWEST:
        return None
    used = highest > (1 - _DEPTH) * highest[-1]
    step = float(np.median(np.diff(t)))
    used &= np.arange(t.size) % max(1, round(_STEP_S / step)) == 0
    t, s, highest = t[used], s[used], highest[used]
    if t.size < _FEWEST:
        return None

    end, duration = (values.reshape(-1, 1, 1) for values in np.meshgrid(time[loss] + _ENDS_S, _DURATIONS_S))
    begin = end - duration
    level = np.interp(begin, t, highest)
    relative = highest / level
    during = (t > begin) & (t < end)
    falling = np.where(t < begin, 1.0, np.clip((end - t) / np.maximum(duration, 1e-9), 0, 1))
    critical, residual = _least_squares(falling, _shape(relative), s)
    rise = np.where(during, relative - 1, 0)

    rate = (1 - np.interp(begin - _RATE_S, t, highest) / level) / _RATE_S
    ramp = np.where(t > begin, 1 + rate * np.minimum(t - begin, duration), relative)
    missing = np.where(during, ramp - relative, 0)

    squared = (residual**2).sum(-1)
    best = residual.reshape(-1, t.size)[squared.argmin()]
    correlation = float(np.clip(best[1:] @ best[:-1] / max(float(best @ best), 1e-12), 0, 0.9))
    share = (1 - correlation) / (1 + correlation)
    variance = max(float(best @ best) / (t.size - 5), _AREA_ERROR**2)
    collapses = share * (squared / variance + ((rise / _STEADY) ** 2).sum(-1))
    fades = math.inf
    for above in _ABOVE:
        fading = _shape(ramp / (1 + rate * duration + above)) * (t < end)
        faded = _least_squares(np.zeros_like(falling), fading, s)[1]
        chi = share * ((faded**2).sum(-1) / variance + ((missing / _STEADY) ** 2).sum(-1))
        fades = min(fades, float(chi.min()) + (above / _STEADY) ** 2)
    weights = np.exp((collapses.min() - collapses) / 2)
    weights /= weights.sum()

    def mean(values: Values) -> tuple[float, float]:
        middle = float((weights * values).sum())
        return middle, math.sqrt(float((weights * (values - middle) ** 2).sum()))

    # A collapse between two successive frames lasts at most the interval between them.
    lasting = np.maximum(duration[..., 0], step)
    (fitted, spread), (speed, speed_std) = mean(critical), mean(critical / lasting)
    return Collapse(
        area=fitted,
        area_std=math.hypot(spread, _AREA_STD),
        rate=speed,
        rate_std=math.hypot(speed_std, _AREA_STD * mean(1 / lasting)[0]),
        duration=mean(duration[..., 0])[0],
        duration_std=math.hypot(mean(duration[..., 0])[1], _DURATION_STD),
        begin=mean(begin[..., 0])[0],
        evidence=fades - float(collapses.min()),
    )


def _shape(relative: Values) -> Values:
    """Return unscaled curves (G, E, F) of the stuck area share d^2 before a collapse, for E curvatures and G histories
    (G, 1, F) of the load relative to that at the collapse.
    """
    return np.sqrt(np.maximum(1 - relative, 0) + _BENDS) - np.sqrt(_BENDS)


def _least_squares(first: Values, second: Values, values: Values) -> tuple[Values, Values]:
    """Fit values (F,) by a first + b second, with factors a, b >= 0, for functions that broadcast to (G, E, F); return
    a (G, E) and the residuals (G, E, F).
    """
    aa, ab, bb = (first**2).sum(-1), (first * second).sum(-1), (second**2).sum(-1)
    av, bv = first @ values, second @ values
    determinant = aa * bb - ab**2
    regular = determinant > 1e-9 * aa * bb
    safe = np.where(regular, determinant, 1)
    a, b = (av * bb - bv * ab) / safe, (bv * aa - av * ab) / safe
    alone_a, alone_b = av / np.maximum(aa, 1e-12), bv / np.maximum(bb, 1e-12)
    only_a, only_b = (~regular & (aa > 0)) | (b < 0), (aa == 0) | (regular & (a < 0))
    a, b = np.where(only_a, alone_a, np.where(only_b, 0, a)), np.where(only_a, 0, np.where(only_b, alone_b, b))
    return np.asarray(a), values - a[..., None] * first - b[..., None] * second
