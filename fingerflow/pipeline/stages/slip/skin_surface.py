"""Spatial interpolation of skin displacement between tracked points."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from fingerflow.kernels.array_types import Points

_FEWEST = 3  # least number of points for a plane


class SkinSurface:
    """Thin plate spline (Duchon 1977) that interpolates displacements of tracked points at other, fixed positions.

    Points and positions are those of one frame, that is, of the skin. All costly steps are done once, and a frame takes
    a product of matrices. Points that are lost in a frame have no influence: they take the value at which they do not
    bend the plate. A system with as many equations as lost points gives these values.

    Args:
        points: (N, 2) mm, finite and not all on a line.
        positions: (Q, 2) mm.

    Raises:
        ValueError: the points do not span an area.
    """

    def __init__(self, points: Points, positions: Points) -> None:
        centre = points.mean(0, keepdims=True) if len(points) else np.zeros((1, 2))
        # Divide by the spread of the points, so that the matrices are well conditioned.
        scale = float(np.abs(points - centre).max(initial=0)) or 1.0
        scaled, queries = (points - centre) / scale, (positions - centre) / scale
        plane, lying = (np.insert(places, 0, 1, axis=1) for places in (scaled, queries))
        if np.linalg.matrix_rank(plane, 1e-9) < _FEWEST:
            raise ValueError(f"{len(scaled)} points do not span an area: a displacement between them is not known")
        bending = _kernel(cdist(scaled, scaled, "sqeuclidean")) + 1e-12 * np.eye(len(scaled))
        # The coefficients of the kernels are orthogonal to planes (Wahba 1990).
        inverse = np.linalg.inv(np.block([[bending, plane], [plane.T, np.zeros((_FEWEST, _FEWEST))]]))
        self._bend, level = np.split(inverse[:, : len(scaled)], [len(scaled)])
        between = _kernel(cdist(queries, scaled, "sqeuclidean"))
        self._weights = (between @ self._bend + lying @ level).astype(np.float32)

    def __call__(self, moved: Points) -> NDArray[np.float32]:
        """Interpolate displacements (N, 2) of points, NaN where lost, at the Q fixed positions; return them as (Q, 2).

        It is NaN where fewer than three points are left.
        """
        lost = ~np.isfinite(moved).all(-1)
        if lost.all() or (~lost).sum() < _FEWEST:
            return np.full((len(self._weights), moved.shape[1]), np.nan, np.float32)
        if lost.any():
            moved = moved.copy()
            block = self._bend[np.ix_(lost, lost)]
            moved[lost] = np.linalg.lstsq(block, -self._bend[np.ix_(lost, ~lost)] @ moved[~lost], rcond=1e-12)[0]
        return self._weights @ moved.astype(np.float32)


def _kernel(squared: Points) -> Points:
    """Return the kernel r^2 log r of a thin plate spline, given squared distances r^2."""
    return squared * np.log(np.maximum(squared, 1e-300)) / 2
