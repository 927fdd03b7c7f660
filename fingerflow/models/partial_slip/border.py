"""Where the stuck part of a contact ends, for who sees the skin blurred: through windows, or by dense flow.

Skin is continuous, and so is its strain: beside the stuck part its displacement begins as k x^p, x the distance from
the border. On an elastic half-space, whose tractions begin with a root, p is 3/2 (Cattaneo 1938, Mindlin 1949); skin
on an elastic bed with bounded tractions has p = 2. p is taken as 7/4: data of one trial do not tell which it is, and
either end changes the level below by a quarter to a third, d^2 by some 0.03.

A tracked point shows the mean over its window, and the windows that reach across the border have moved before their
centre has. At the border itself they show the level

    k E[max(xi, 0)^p - max(xi - w, 0)^p],

xi the places in the window along the normal of the border, w the width of the annulus that slips: beyond the contact
nothing holds the skin, which moves as its rim does. Displacement below that level is what stuck skin shows. Below a
fixed length of it (40 um in Terekhov & Hayward 2011) is also skin that has slipped by less. Dense flow shows less at
the border, as it looks less far and is stiff; what it shows of x^p is measured
(`pipeline.stages.slip.flow_resolution`).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]
#: What is seen, mm^p, of a displacement x^p beyond a border, at distances (K,) mm from it, negative inside.
Seen = Callable[[Values], Values]

POWER = 1.75  # p

_SAMPLES = 24  # of a window along either side
_ANGLES = (np.arange(3) + 0.5) * np.pi / 12  # of the border to the window, 0 to 45 degrees
_FEWEST = 8  # distances with a displacement


class BorderFit(NamedTuple):
    """`fit_border`'s answer.

    Attributes:
        growth: k: displacement is k x^p mm at a distance of x mm beyond the border, p = `POWER`.
        offset: mm, where the border lies on the scale of the distances.
        base: mm, what skin shows that has not moved.
        error: mm, root mean square of what the fit leaves.
    """

    growth: float
    offset: float
    base: float
    error: float


def window_places(half_window: float) -> Values:
    """Places (K,) mm of a square window along the normal of a border, for borders in all directions, in order."""
    side = half_window * ((np.arange(_SAMPLES) + 0.5) / _SAMPLES * 2 - 1)
    across, along = np.cos(_ANGLES)[:, None, None] * side, np.sin(_ANGLES)[:, None, None] * side[:, None]
    return np.asarray(np.sort((across + along).ravel()))


def seen_displacement(distance: Values, half_window: float) -> Values:
    """What windows show, (K,), of a displacement x^p beyond a border, at distances (K,) mm from it; negative inside."""
    places = window_places(half_window)
    return np.asarray((np.maximum(distance[:, None] + places, 0) ** POWER).mean(1))


def border_level(width: Values, growth: float, seen: Seen) -> Values:
    """mm (K,), what is seen at the border of the stuck part where the slipping annulus is (K,) mm wide."""
    return np.asarray(growth * (seen(np.zeros(1)) - seen(-np.maximum(width, 0))))


def fit_border(distance: Values, displacement: Values, weight: Values, seen: Seen, step: float) -> BorderFit | None:
    """Where a displacement that is seen blurred begins.

    Weighted least squares in k and the base, which enter linearly, for each of the places where the border may lie.

    Args:
        distance: (K,) mm from some contour of the displacement, positive on the side that sticks.
        displacement: (K,) mm along the slip, a mean over points at this distance.
        weight: (K,) one over its variance.
        seen: how it is blurred.
        step: mm between the places that are tried.

    Returns:
        None where the displacement does not grow, or at fewer than eight distances.
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
