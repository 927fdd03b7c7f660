"""Interpolation of skin displacement between tracked points to two grids on the contact: cells, and a fine grid of four
times the resolution.
"""

import math

import cv2
import numpy as np
from scipy.ndimage import convolve1d, map_coordinates, uniform_filter
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from fingerflow.kernels.array_types import Array, Field, Mask, Points
from fingerflow.pipeline.stages.preparation.series import rate

_FEWEST = 3  # least number of points for a plane
_NEAREST = 4  # points whose mean displacement is that of the skin at the border
_FINE = 4  # positions per cell along each axis: areas are then known to a thousandth of the contact

_GROWTH_S, _JITTER_S = 0.15, 0.5  # s, times over which a rate of area and the noise of areas are measured
_WAVES, _SHARES = np.polynomial.hermite_e.hermegauss(16)  # quadrature over the normal distribution


class SlipGrid:
    """Grid of cells over the contact region of the first frame, to which displacements of points are interpolated.

    Sticking skin stays where it was in the first frame. So a cell of a later frame sticks if the skin that lay there at
    first sticks, and positions are the same in all frames.

    Args:
        points: (N, 2) mm, tracked points in the first frame, finite.
        shape: rows and columns of cells.
        cell_mm, first_cell_mm: side of a cell and centre of the first one.
        reach_mm: distance from a point within which displacement is known.

    Attributes:
        points: as given.
        known: (rows, columns) bool, cells whose displacement is known.
        fine_mm: spacing of the fine grid.

    Raises:
        ValueError: the points do not span an area.
    """

    def __init__(
        self, points: Array, shape: tuple[int, ...], cell_mm: float, first_cell_mm: float, reach_mm: float
    ) -> None:
        y, x = (np.arange(size) * cell_mm + first_cell_mm for size in shape)
        self.centers = np.stack(np.meshgrid(x, y), axis=-1)
        self.points = points
        self.fine_mm = cell_mm / _FINE
        self.known: Mask = cKDTree(points).query(self.centers)[0] <= reach_mm
        self._surface = SkinSurface(points, self.centers[self.known])
        at = np.rint(((points - first_cell_mm) / cell_mm + 0.5) * _FINE - 0.5).astype(int)
        self._column, self._row = at.clip(0, _FINE * np.array(shape[::-1]) - 1).T

    def displacement(self, moved: Array) -> Field:
        """Interpolate displacements (N, 2) mm of points to cells (rows, columns, 2); 0 in cells far from all points."""
        result = np.zeros((*self.known.shape, 2), np.float32)
        result[self.known] = self._surface(moved)
        return result

    def fine(self, values: Field) -> Field:
        """Interpolate cell values, (rows, columns) or (rows, columns, C), linearly to the fine grid."""
        rows, columns = values.shape[:2]
        size = (columns * _FINE, rows * _FINE)
        return cv2.resize(values, size, interpolation=cv2.INTER_LINEAR).astype(np.float32, copy=False)

    def fine_mask(self, cells: Mask) -> Mask:
        """Convert a mask of cells to a mask on the fine grid."""
        return cells.repeat(_FINE, 0).repeat(_FINE, 1)

    def cells(self, fine: Mask) -> Mask:
        """Convert a mask on the fine grid to a mask of cells: True where at least half of a cell is covered."""
        rows, columns = self.known.shape
        return fine.reshape(rows, _FINE, columns, _FINE).mean((1, 3)) >= 0.5

    def share(self, fine: Mask, region: Mask) -> float:
        """Return the area of a mask on the fine grid divided by the area of the mask `region` on the grid of cells."""
        return float(fine.sum()) / (_FINE**2 * int(region.sum()))

    def growth(self, regions: tuple[Mask, Mask], earlier: Array, later: Array, pull: Array) -> Array:
        """Return the areas (2,), mm², of skin that the contact gained between two frames, in the half that lies towards
        `pull` and in the other: negative where skin left it; NaN where too few points are known.

        A cell of the later contact gained skin as far as its skin lay outside of the earlier one.

        Args:
            regions: (rows, columns) cells in contact in the two frames.
            earlier, later: (N, 2) mm, displacement of the points in them, NaN where lost.
            pull: (2,) direction.
        """
        tracked = np.isfinite(earlier + later).all(-1)
        if tracked.sum() < _NEAREST:
            return np.full(2, np.nan)
        way, size, (before, after) = (later - earlier)[tracked], _FINE * self.fine_mm, regions
        reach = 1 + math.ceil(np.abs(way).max() / size)  # cells within which skin can have crossed the border
        near = uniform_filter(1.0 * before + after, 2 * reach + 1)  # 0 and 2 where none and all are in contact
        band = (near > 1e-6) & (near < 2 - 1e-6)
        centers = self.centers[band]
        nearest = cKDTree((self.points + later)[tracked]).query(centers, k=_NEAREST)[1]
        at = (centers - way[nearest].mean(1) - self.centers[0, 0]) / size
        gained = size**2 * (after[band] - map_coordinates(1.0 * before, at.T[::-1], order=1))
        ahead = (centers - self.centers[after].mean(0)) @ pull > 0
        return np.array([gained[ahead].sum(), gained[~ahead].sum()])

    def sample_points(self, fine: Array) -> Array:
        """Return the values (N,) of a field on the fine grid, at the positions of the points in the first frame."""
        return fine[self._row, self._column]


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

    def __call__(self, moved: Points) -> Field:
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


def growth_rates(growth: Array, times: Array, area: Array, area_std: Array, ridge_mm: float) -> tuple[Array, Array]:
    """Return the rates (2, F), mm²/s, at which the halves of the contact gain skin over 0.15 s, and their standard
    deviations (2, F).

    Noise of a frame is taken back by the next one; it follows from the misfit within half a second. The border runs
    along the outermost ridge, so that a half errs by an area which changes with the skin that lies on the border. For
    ridges of all directions the correlation is exp(-(pi s / ridge_mm)²), s being the way of the skin through the border
    between two frames: that of waves of normally distributed frequencies, whose slopes make the variance.

    Args:
        growth: (2, F) mm², skin gained since the frame before, NaN where unknown.
        times: (F,) s, time of each frame.
        area, area_std: (F,) mm², of the contact, whose halves err independently.
        ridge_mm: distance between ridges.
    """
    if len(times) < 2:
        return np.full(growth.shape, np.nan), np.full(growth.shape, np.nan)
    known, gained = np.isfinite(growth), np.nan_to_num(growth)
    rates = rate(np.where(known, gained.cumsum(1), np.nan).T, times, _GROWTH_S).T
    misfit = np.nan_to_num(gained - rates * np.gradient(times)) ** 2 / 2
    frames = 1 + round(_JITTER_S * len(times) / max(float(np.ptp(times)), 1e-9))
    # Do not use running sums: their rounding can make a mean of squares negative.
    total, count = convolve1d(np.stack((misfit, 1.0 * np.isfinite(rates))), np.ones(frames), mode="nearest")
    jitter = np.where(known, np.sqrt(total / np.maximum(count, 1.0)), np.nan)
    way = np.nancumsum(rates * np.gradient(times) / np.sqrt(4 / np.pi * np.where(area > 0, area, np.nan)), axis=1).T
    phase = math.sqrt(2) * np.pi / ridge_mm * way[..., None] * _WAVES
    slopes = rate(np.stack((np.cos(phase), np.sin(phase)), -1), times, _GROWTH_S)
    border = area_std * np.sqrt((slopes**2).sum(-1) @ _SHARES / _SHARES.sum() / 2).T
    return rates, np.hypot(rate(jitter.T, times, _GROWTH_S, of_std=True).T, border)
