"""Border of a contact's stick region, fitted to displacement that tracking windows or dense flow have blurred.

Skin and its strain are continuous, so beside the stick region the displacement begins as k x^p, with x the distance
from the border. On an elastic half-space, whose tractions begin with a square root, p is 3/2 (Cattaneo 1938, Mindlin
1949). Skin on an elastic bed with bounded tractions has p = 2. One trial's data do not tell which p holds, so p is
taken as 7/4. Either extreme changes the level below by a quarter to a third, and d^2 by about 0.03.

A tracked point shows the mean over its window, so windows that reach across the border move before their
centre does. At the border they show the level

    k E[max(xi, 0)^p - max(xi - w, 0)^p],

xi the positions in the window along the border's normal, w the width of the slipping annulus. Beyond the contact
nothing holds the skin, which moves as its rim does. Displacement below that level counts as stick. A fixed threshold
(40 um in Terekhov & Hayward 2011) also counts skin that has slipped by less. Dense flow shows less at the border,
because its support is smaller and it is regularised; its response to x^p is measured
(`pipeline.stages.slip.flow_resolution`).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]
#: Measured (blurred) value, mm^p, of a displacement x^p beyond a border, at distances (K,) mm from it, negative inside.
Seen = Callable[[Values], Values]

POWER = 1.75  # p

_SAMPLES = 24  # along each side of a window
_ANGLES = (np.arange(3) + 0.5) * np.pi / 12  # between border and window, 0 to 45 degrees
_FEWEST = 8  # distances with a displacement


class BorderFit(NamedTuple):
    """Fitted border of a stick region: position, and growth of the displacement beyond the border.

    Attributes:
        growth: k: displacement is k x^p mm at a distance of x mm beyond the border, p = `POWER`.
        offset: mm, position of the border on the scale of the distances.
        base: mm, measured displacement of skin that has not moved.
        error: mm, root mean square residual of the fit.
    """

    growth: float
    offset: float
    base: float
    error: float


def window_places(half_window: float) -> Values:
    """Return distances (K,) mm of a square window's pixels from its centre along the normal of a border.

    They are pooled over several directions of the border.

    The positions are sorted.
    """
    side = half_window * ((np.arange(_SAMPLES) + 0.5) / _SAMPLES * 2 - 1)
    across, along = np.cos(_ANGLES)[:, None, None] * side, np.sin(_ANGLES)[:, None, None] * side[:, None]
    return np.asarray(np.sort((across + along).ravel()))


def seen_displacement(distance: Values, half_window: float) -> Values:
    """Return the window mean of a displacement x^p beyond a border, at window distances (K,) mm (negative inside)."""
    places = window_places(half_window)
    return np.asarray((np.maximum(distance[:, None] + places, 0) ** POWER).mean(1))


def border_level(width: Values, growth: float, seen: Seen) -> Values:
    """Return the displacement (K,), mm, measured at a stick border beside a slipping annulus (K,) mm wide."""
    return np.asarray(growth * (seen(np.zeros(1)) - seen(-np.maximum(width, 0))))


def fit_border(distance: Values, displacement: Values, weight: Values, seen: Seen, step: float) -> BorderFit | None:
    """Fit the position of the border at which a blurred displacement begins.

    Weighted least squares in k and the base, which enter linearly, at each candidate position of the border.

    Args:
        distance: (K,) mm from some contour of the displacement, positive on the side that sticks.
        displacement: (K,) mm along the slip, a mean over points at this distance.
        weight: (K,) inverse variance of the displacement.
        seen: the blur, as `seen_displacement`.
        step: mm between candidate positions.

    Returns:
        The candidate with the least error; None if the displacement does not grow, or at fewer than eight distances.
    """
    if len(distance) < _FEWEST:
        return None
    root = np.sqrt(weight / weight.mean())
    offsets = np.arange(distance.min(), distance.max(), step)
    best: BorderFit | None = None
    for offset in offsets:
        shape = seen(offset - distance)
        if shape.max() <= 0:
            continue
        matrix = np.stack((shape, np.ones_like(shape)), 1) * root[:, None]
        found, _, rank, _ = np.linalg.lstsq(matrix, displacement * root, rcond=None)
        left = float(np.sqrt(np.mean((matrix @ found - displacement * root) ** 2)))
        if rank == 2 and found[0] > 0 and (best is None or left < best.error):
            best = BorderFit(float(found[0]), float(offset), float(found[1]), left)
    return best
