"""Triangles of skin that was advected into the contact (`tracker.entry`)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError

Points = NDArray[np.float64]
Numbers = NDArray[np.integer]


class EntryTriangles(NamedTuple):
    """Triangles (M, 3) with at least one advected point, and the frame (M,) from which each counts.

    That is the frame in which the last of its points has touched.
    """

    corners: NDArray[np.int32]
    begins: NDArray[np.int64]


def entry_triangles(entered: Numbers, places: Points, onset: Numbers) -> EntryTriangles:
    """Return the Delaunay triangles with advected points, by the ``places`` (N, 2) of points that have touched."""
    triangles = triangulate(np.where((onset >= 0)[:, None], places, np.nan))
    triangles = triangles[np.isin(triangles, entered).any(1)]
    return EntryTriangles(triangles, onset[triangles].max(1, initial=0).astype(np.int64))


def triangulate(reference: Points) -> NDArray[np.int32]:
    """Return Delaunay triangles (M, 3) of the finite points; none where fewer than three of them span an area."""
    finite = np.flatnonzero(np.isfinite(reference).all(-1))
    if len(finite) < 3:
        return np.zeros((0, 3), dtype=np.int32)
    try:
        result: NDArray[np.int32] = finite[Delaunay(reference[finite]).simplices].astype(np.int32)
        return result
    except QhullError:  # all on one line
        return np.zeros((0, 3), dtype=np.int32)
