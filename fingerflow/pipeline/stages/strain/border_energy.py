"""Uncertainty of the strain energy that comes from the uncertain position of the contact border.

Strain since the onset is largest along the border of a growing contact, where skin that has moved lies beside skin that
has just come into contact. A border that is displaced all around changes the onset of the outermost points and the set
of triangles that count.
"""

import numpy as np
from numpy.typing import NDArray

from fingerflow.tracker.contact_border import BORDER_MM, Border

Values = NDArray[np.floating]


def border_energy(
    density: Values, areas: Values, places: Values, border: Border, reach_mm: float
) -> NDArray[np.float64]:
    """Return the strain energy per depth (n,), mJ/mm, in a border strip as wide as the border position is uncertain.

    The strip has the mean energy density of the triangles within `reach_mm` of the border; 0 where there are none.

    Args:
        density: (n, M) mJ/mm^3, NaN for triangles that do not count.
        areas: (M,) mm^2.
        places: (n, M, 2) mm, centroids of the triangles.
        border: of these n frames.
        reach_mm: width of the zone that is averaged.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = np.where((border.inside(places) < reach_mm) & np.isfinite(density), areas, 0.0)
        mean = (weights * np.nan_to_num(density)).sum(1, dtype=np.float64) / weights.sum(1, dtype=np.float64)
    # Ramanujan (1914) for the perimeter.
    sums, turned = border.semi_axes.sum(1), border.semi_axes[:, ::-1]
    perimeter = np.pi * (3 * sums - np.sqrt((3 * border.semi_axes + turned).prod(1)))
    result: NDArray[np.float64] = np.nan_to_num(BORDER_MM * perimeter * mean)
    return result
