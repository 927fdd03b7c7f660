"""Spatial interpolation of skin displacement between tracked points."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, null_space
from scipy.spatial.distance import cdist

Points = NDArray[np.float64]
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
        if len(points) < _FEWEST:
            raise ValueError(f"{len(points)} points do not span an area: a displacement between them is not known")
        centre = points.mean(0)
        # Divide by the spread of the points, so that the matrices are well conditioned.
        scale = float(np.abs(points - centre).max()) or 1.0
        scaled, queries = (points - centre) / scale, (positions - centre) / scale
        plane = np.concatenate((np.ones((len(scaled), 1)), scaled), 1)
        free = null_space(plane.T, rcond=1e-9)
        if free.shape[1] != len(scaled) - _FEWEST:
            raise ValueError(f"{len(scaled)} points do not span an area: a displacement between them is not known")
        bending = _kernel(cdist(scaled, scaled, "sqeuclidean"))
        # The bending energy is positive definite on coefficients orthogonal to planes (Wahba 1990).
        self._bend = np.zeros_like(bending)
        if free.shape[1]:
            self._bend = free @ cho_solve(cho_factor(free.T @ bending @ free + 1e-12 * np.eye(free.shape[1])), free.T)
        level = np.linalg.pinv(plane) @ (np.eye(len(scaled)) - bending @ self._bend)
        between = _kernel(cdist(queries, scaled, "sqeuclidean"))
        lying = np.concatenate((np.ones((len(queries), 1)), queries), 1)
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
