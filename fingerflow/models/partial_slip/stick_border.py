"""Border of a contact's stick region, fitted to displacement that tracking windows or dense flow have blurred.

Skin and its strain are continuous, so beside the stick region the displacement begins as k x^p, with x the distance
from the border. On an elastic half-space, whose tractions begin with a square root, p is 3/2 (Cattaneo 1938, Mindlin
1949). Skin on an elastic bed with bounded tractions has p = 2. Where friction jumps at the border (mu_s > mu_k), the
half-space has x ln(1/x), close to x^0.85 over the distances of the fit. So p is fitted, between 3/4 and 2.

A tracked point shows the mean over its window, so windows that reach across the border move before their
centre does. At the border they show the level

    k E[max(xi, 0)^p - max(xi - w, 0)^p],

xi the positions in the window along the border's normal, w the width of the slipping annulus. Beyond the contact
nothing holds the skin, which moves as its rim does. Displacement below that level counts as stick. A fixed threshold
(40 um in Terekhov & Hayward 2011) also counts skin that has slipped by less. Dense flow shows less at the border,
because its support is smaller and it is regularised; its response to x^p is measured
(`pipeline.stages.slip.flow_resolution`).
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]
#: Measured (blurred) value, mm^p, of a displacement x^p beyond a border, at distances (K,) mm from it, negative inside,
#: and the power p.
Seen = Callable[[Values, float], Values]

POWERS = np.arange(0.75, 2.01, 0.0625)  # candidates for p

_SAMPLES = 24  # along each side of a window
_PLACES = 96  # means of neighbouring samples, by their distance from the border
_ANGLES = (np.arange(3) + 0.5) * np.pi / 12  # between border and window, 0 to 45 degrees
_FEWEST = 8  # distances with a displacement
_FREE = 4  # power, position, growth and base


class BorderFit(NamedTuple):
    """Border of a stick region, fitted by `fit_border`: position, and growth of the displacement beyond that border.

    Attributes:
        power: p; `power_std`, its standard deviation.
        growth: k: displacement is k x^p mm at a distance of x mm beyond the border.
        offset: mm, position of the border on the scale of the distances; `offset_std`, its standard deviation.
        base: mm, measured displacement of skin that has not moved.
        error: mm, root mean square residual of the best candidate.
    """

    power: float
    power_std: float
    growth: float
    offset: float
    offset_std: float
    base: float
    error: float


def window_places(half_window: float) -> Values:
    """Return sorted offsets (K,) mm along the normal of a border, each of as many pixels of a square window.

    They are pooled over directions of the border.
    """
    side = half_window * ((np.arange(_SAMPLES) + 0.5) / _SAMPLES * 2 - 1)
    across, along = np.cos(_ANGLES)[:, None, None] * side, np.sin(_ANGLES)[:, None, None] * side[:, None]
    return np.asarray(np.sort((across + along).ravel()).reshape(_PLACES, -1).mean(1))


def seen_displacement(distance: Values, power: float, half_window: float) -> Values:
    """Return window means of a displacement x^p beyond a border, at distances (K,) mm from it (negative inside)."""
    places = window_places(half_window)
    return np.asarray((np.maximum(distance[:, None] + places, 0) ** power).mean(1))


def border_level(width: Values, fit: BorderFit, seen: Seen) -> Values:
    """Return the displacement, mm (K,), that is measured at a stick border if the slipping annulus is (K,) mm wide."""
    return np.asarray(fit.growth * (seen(np.zeros(1), fit.power) - seen(-np.maximum(width, 0), fit.power)))


def fit_border(distance: Values, displacement: Values, weight: Values, seen: Seen, step: float) -> BorderFit | None:
    """Fit the position of the border at which a blurred displacement begins, and the power with which it does.

    k and the base follow by weighted least squares for each candidate of position and power. Means and deviations of
    both are taken over the candidates, with weights exp(-chi^2 / 2); the least chi^2 is scaled to its degrees of
    freedom where it exceeds them.

    Args:
        distance: (K,) mm from some contour of the displacement, positive on the side that sticks.
        displacement: (K,) mm along the slip, a mean over points at this distance.
        weight: (K,) inverse variance of the displacement.
        seen: the blur, as `seen_displacement`.
        step: mm between candidate positions.

    Returns:
        None if the displacement does not grow, or at fewer than eight distances.
    """
    if len(distance) < _FEWEST:
        return None
    offsets = np.arange(distance.min(), distance.max(), step)
    squared = np.full((POWERS.size, offsets.size), np.inf)
    at = np.arange(offsets[0] - distance.max(), offsets[-1] - distance.min() + step, step)
    for row, power in zip(squared, POWERS, strict=True):
        shape = np.interp(offsets[:, None] - distance, at, seen(at, float(power)))
        growth, _, chi = _lines(shape, displacement, weight)
        row[:] = np.where(growth > 0, chi, np.inf)
    least = float(squared.min())
    if not np.isfinite(least):
        return None
    likely = np.exp((least - squared) / 2 / max(1.0, least / (len(distance) - _FREE)))
    likely /= likely.sum()
    (power, power_std), (offset, offset_std) = (
        _mean_and_deviation(values, likely.sum(axis)) for values, axis in ((POWERS, 1), (offsets, 0))
    )
    growth, base, _ = _lines(seen(offset - distance, power)[None], displacement, weight)
    error = math.sqrt(least / float(weight.sum()))
    return BorderFit(power, power_std, float(growth[0]), offset, offset_std, float(base[0]), error)


def _lines(shapes: Values, values: Values, weight: Values) -> tuple[Values, Values, Values]:
    """Fit values (K,) by a multiple of each shape (C, K) and a constant; return both (C,), and chi^2 (C,)."""
    share = weight / weight.sum()
    mean, level = shapes @ share, float(values @ share)
    apart, rest = shapes - mean[:, None], values - level
    spread = apart**2 @ weight
    growth = np.where(spread > 0, apart @ (weight * rest) / np.where(spread > 0, spread, 1), 0)
    return growth, level - growth * mean, (rest - growth[:, None] * apart) ** 2 @ weight


def _mean_and_deviation(values: Values, weights: Values) -> tuple[float, float]:
    mean = float(values @ weights)
    return mean, math.sqrt(float((values - mean) ** 2 @ weights))
