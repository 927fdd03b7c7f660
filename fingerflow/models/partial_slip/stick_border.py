"""Fit the border of a contact's stick region to displacement that tracking windows or dense flow have blurred.

Beside the stick region, at a distance x from the border, the displacement is k g(x),

    g(x) = (x^2 + a^2)^(p / 2) - a^p.

On an elastic half-space, whose tractions begin with a square root, p is 3/2 and a is 0 (Cattaneo 1938, Mindlin
1949). Skin on an elastic bed with bounded tractions has p = 2. Where friction jumps at the border (mu_s > mu_k), the
half-space has x ln(1/x), close to x^0.85 over the distances of the fit. A rounding a smaller than a window is hardly
visible, and moves the border. So p, between 3/4 and 2, and a are fitted, and what they leave open is a deviation. A
fixed p of 7/4 has three times the error over such laws; a normal prior on p changes it little (`docs/methods/slip.md`).

A tracked point shows the mean over its window, so windows that reach across the border move before their
centre does. At the border they show the level

    k E[g(max(xi, 0)) - g(max(xi - w, 0))],

xi the positions in the window along the border's normal, w the width of the slipping annulus. Beyond the contact
nothing holds the skin, which moves as its rim does. Displacement below that level counts as stick. A fixed threshold
(40 um in Terekhov & Hayward 2011) also counts skin that has slipped by less. Dense flow shows less at the border,
because its support is smaller and it is regularised; its response is measured
(`pipeline.stages.slip.skin_flow`). The blur is linear, so the response to a ramp gives that to any g.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]
#: Function that returns the measured (blurred) displacement, mm, of a ramp max(x, 0) at distances x in mm.
RampResponse = Callable[[Values], Values]

POWERS = np.arange(0.75, 2.01, 0.125)  # candidates for the power p
ROUNDINGS = np.array([0, 0.25, 0.5, 0.75, 1, 1.25])  # candidates for the rounding a, in half windows
_KNOTS = np.linspace(0, 1, 81) ** 2  # starting points of the ramps that make up g, as shares of the range of distances
# mm, added to the range of distances: more than a window, so that displacement which the blur spreads is included.
_BLUR_MM = 1.0

_SAMPLES = 24  # samples along each side of a window
_PLACES = 96  # number of offsets along the border's normal, each the mean of neighbouring samples
_ANGLES = (np.arange(3) + 0.5) * np.pi / 12  # rad, angles between border and window, 0 to 45 degrees
_FEWEST = 8  # least number of distances with a displacement
_FREE = 5  # number of fitted parameters: power, rounding, position, growth and base


class BorderFit(NamedTuple):
    """Fitted border of a stick region: position, and growth of the displacement beyond the border.

    Attributes:
        power: p; `power_std`, its standard deviation.
        rounding: a, mm.
        growth: k: displacement is k g(x) mm at a distance of x mm beyond the border.
        offset: mm, position of the border on the scale of the distances; `offset_std`, its standard deviation.
        base: mm, measured displacement of skin that has not moved.
        error: mm, root mean square residual of the best candidate.
    """

    power: float
    power_std: float
    rounding: float
    growth: float
    offset: float
    offset_std: float
    base: float
    error: float

    def blurred_displacement(self, distance: Values, seen: RampResponse) -> Values:
        """Return the displacement, mm, that a measurement with the blur `seen` shows at distances (K,) mm beyond the
        border of the stick region, relative to skin that has not moved.
        """
        return self.growth * _blurred(distance, np.array([self.power]), np.array([self.rounding]), seen)[0]

    def slip_distance(self, displacement: float) -> float:
        """Return the distance beyond the border of the stick region, mm, at which the fitted, unblurred displacement
        reaches a value, mm.
        """
        reached = (displacement / self.growth + self.rounding**self.power) ** (2 / self.power)
        return math.sqrt(max(reached - self.rounding**2, 0.0))


def window_offsets(half_window: float) -> Values:
    """Return offsets (K,) mm along the normal of a border that sample the pixels of a square window evenly, sorted.

    They are pooled over directions of the border.
    """
    side = half_window * ((np.arange(_SAMPLES) + 0.5) / _SAMPLES * 2 - 1)
    across, along = np.cos(_ANGLES)[:, None, None] * side, np.sin(_ANGLES)[:, None, None] * side[:, None]
    return np.sort((across + along).ravel()).reshape(_PLACES, -1).mean(1)


def blurred_ramp(distance: Values, half_window: float) -> Values:
    """Return the mean of the ramp max(x, 0), x being the distance beyond a border, over a square tracking window of
    half width `half_window` mm whose centre lies at given distances (mm) beyond the border.

    A distance is negative on the side that sticks.
    """
    offsets = window_offsets(half_window)
    at = np.linspace(-2 * half_window, 2 * half_window, 400)
    means = np.maximum(at[:, None] + offsets, 0).mean(1)
    return np.where(distance > at[-1], distance, np.interp(distance, at, means))


def border_level(width: Values, fit: BorderFit, seen: RampResponse) -> Values:
    """Return the displacement (K,), mm, that a measurement with the blur `seen` shows at the border of a stick region,
    if skin slips by the fitted law across an annulus (K,) mm wide and moves rigidly beyond it.
    """
    return fit.blurred_displacement(np.zeros(1), seen) - fit.blurred_displacement(-np.maximum(width, 0), seen)


def fit_border(
    distance: Values, displacement: Values, weight: Values, seen: RampResponse, half_window: float
) -> BorderFit | None:
    """Fit the position of a stick region's border, and the law by which displacement grows beyond it, to displacement
    (K,) mm at distances (K,) mm from a contour, as blurred by tracking windows.

    k and the base follow by weighted least squares for each candidate of position, power and rounding. Means and
    deviations are taken over the candidates, with weights exp(-chi^2 / 2); the least chi^2 is scaled to its degrees of
    freedom where it exceeds them.

    Args:
        distance: (K,) mm from some contour of the displacement, positive on the side that sticks.
        displacement: (K,) mm along the slip, a mean over points at this distance.
        weight: (K,) inverse variance of the displacement.
        seen: the blur, as `blurred_ramp`.
        half_window: mm; candidate positions are a fiftieth of it apart.

    Returns:
        None if the displacement does not grow, or at fewer than eight distances.
    """
    if len(distance) < _FEWEST:
        return None
    step = half_window / 50
    offsets = np.arange(distance.min(), distance.max(), step)
    powers, roundings = (grid.ravel() for grid in np.meshgrid(POWERS, half_window * ROUNDINGS, indexing="ij"))
    at = np.arange(offsets[0] - distance.max(), offsets[-1] - distance.min() + step, step)
    squared = np.full((powers.size, offsets.size), np.inf)
    for row, values in zip(squared, _blurred(at, powers, roundings, seen), strict=True):
        growth, _, chi = _lines(np.interp(offsets[:, None] - distance, at, values), displacement, weight)
        row[:] = np.where(growth > 0, chi, np.inf)
    least = float(squared.min())
    if not np.isfinite(least):
        return None
    likely = np.exp((least - squared) / 2 / max(1.0, least / (len(distance) - _FREE)))
    likely[roundings > 0] /= len(ROUNDINGS) - 1  # all roundings above 0 together are as probable as no rounding
    likely /= likely.sum()
    (power, power_std), (rounding, _), (offset, offset_std) = (
        _mean_and_deviation(values, likely.sum(axis)) for values, axis in ((powers, 1), (roundings, 1), (offsets, 0))
    )
    shape = _blurred(offset - distance, np.array([power]), np.array([rounding]), seen)
    growth, base, _ = _lines(shape, displacement, weight)
    error = math.sqrt(least / float(weight.sum()))
    return BorderFit(power, power_std, rounding, float(growth[0]), offset, offset_std, float(base[0]), error)


def _blurred(distance: Values, powers: Values, roundings: Values, seen: RampResponse) -> Values:
    """Return the law g (L, K) of displacement growth for L powers and L roundings, blurred by the response `seen` of
    the measurement, at distances (K,) mm beyond the border.
    """
    # Ramps that begin at the knots add up to g, linear in between. The first knots are close together, where a small
    # power bends most.
    knots = (max(float(distance.max()), 0.0) + _BLUR_MM) * _KNOTS
    p, a = powers[:, None], roundings[:, None]
    law = (knots**2 + a**2) ** (p / 2) - a**p
    return np.diff(np.diff(law) / np.diff(knots), prepend=0.0) @ seen(distance - knots[:-1, None])


def _lines(shapes: Values, values: Values, weight: Values) -> tuple[Values, Values, Values]:
    """Fit values (K,) by a multiple of each of C shapes (C, K) plus a constant, by weighted least squares; return
    factor, constant and chi^2, (C,) each.
    """
    share = weight / weight.sum()
    mean, level = shapes @ share, float(values @ share)
    centred, rest = shapes - mean[:, None], values - level
    spread = centred**2 @ weight
    growth = np.where(spread > 0, centred @ (weight * rest) / np.where(spread > 0, spread, 1), 0)
    return growth, level - growth * mean, (rest - growth[:, None] * centred) ** 2 @ weight


def _mean_and_deviation(values: Values, weights: Values) -> tuple[float, float]:
    mean = float(values @ weights)
    return mean, math.sqrt(float((values - mean) ** 2 @ weights))
