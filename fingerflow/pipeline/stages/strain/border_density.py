"""Strain energy density along the border of the contact.

Strain since the onset is largest along the border of a growing contact, where skin that has moved lies beside skin that
has just come into contact. A border that is displaced all around changes the onset of the outermost points and the set
of triangles that count.
"""

import numpy as np
from numpy.typing import NDArray

from fingerflow.tracker.contact_border import Border

Values = NDArray[np.floating]


def border_density(
    density: Values, areas: Values, positions: Values, border: Border, reach_mm: float
) -> NDArray[np.float64]:
    """Return the mean strain energy density (n,), mJ/mm^3, in n frames of the triangles that lie within `reach_mm` of
    the contact border, weighted by area.

    It is 0 in frames without such triangles.

    Args:
        density: (n, M) mJ/mm^3, NaN for triangles that do not count.
        areas: (M,) mm^2.
        positions: (n, M, 2) mm, centroids of the triangles.
        border: of these n frames.
        reach_mm: width of the zone that is averaged.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = np.where((border.inside(positions) < reach_mm) & np.isfinite(density), areas, 0.0)
        mean = (weights * np.nan_to_num(density)).sum(1, dtype=np.float64) / weights.sum(1, dtype=np.float64)
    result: NDArray[np.float64] = np.nan_to_num(mean)
    return result
