"""Where displacement is looked up in a contact: the cells of its region, and four times as fine."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fingerflow.pipeline.stages.slip.skin_surface import SkinSurface

Array = NDArray[np.float64]
Field = NDArray[np.float32]
Mask = NDArray[np.bool_]

_FINE = 4  # places along a cell: an area is then known to a thousandth of the contact


class SlipGrid:
    """The skin that lies on the cells of the contact's region in the first frame.

    Skin that sticks is in every frame where it was in the first one, so whether a cell of a later frame sticks is asked
    of the skin that lay there at first: places stay the same from frame to frame.

    Args:
        points: (N, 2) mm, tracked points in the first frame, finite.
        shape: rows and columns of cells.
        cell_mm, first_cell_mm: side of a cell and centre of the first one.
        reach_mm: how far from a point displacement is known.

    Attributes:
        points: as given.
        known: (rows, columns) cells whose displacement is known.
        fine_mm: distance of the fine places.

    Raises:
        ValueError: the points do not span an area.
    """

    def __init__(
        self, points: Array, shape: tuple[int, int], cell_mm: float, first_cell_mm: float, reach_mm: float
    ) -> None:
        y, x = (np.arange(size) * cell_mm + first_cell_mm for size in shape)
        self.places = np.stack(np.meshgrid(x, y), axis=-1)
        self.points = points
        self.fine_mm = cell_mm / _FINE
        self.known: Mask = np.zeros(shape, dtype=bool)
        if len(points):
            distance, _ = cKDTree(points).query(self.places.reshape(-1, 2))
            self.known = (distance <= reach_mm).reshape(shape)
        self._surface = SkinSurface(points, self.places[self.known])
        at = ((points - first_cell_mm) / cell_mm + 0.5) * _FINE - 0.5
        self._column, self._row = (
            np.clip(np.rint(at[:, k]).astype(int), 0, _FINE * size - 1) for k, size in enumerate(shape[::-1])
        )

    def displacement(self, moved: Array) -> Field:
        """(rows, columns, 2) mm, from that (N, 2) of the points, NaN where one is lost; 0 where it is not known."""
        result = np.zeros((*self.known.shape, 2), np.float32)
        result[self.known] = self._surface(moved)
        return result

    def fine(self, values: Field) -> Field:
        """Values of cells (rows, columns) or (rows, columns, C) at the fine places, linear in between."""
        rows, columns = values.shape[:2]
        size = (columns * _FINE, rows * _FINE)
        result: Field = cv2.resize(values, size, interpolation=cv2.INTER_LINEAR).astype(np.float32, copy=False)
        return result

    def fine_mask(self, cells: Mask) -> Mask:
        """The fine places in cells."""
        return np.asarray(cells.repeat(_FINE, 0).repeat(_FINE, 1))

    def cells(self, fine: Mask) -> Mask:
        """Cells of which half or more is in a fine mask."""
        rows, columns = self.known.shape
        return np.asarray(fine.reshape(rows, _FINE, columns, _FINE).mean((1, 3)) >= 0.5)

    def share(self, fine: Mask, region: Mask) -> float:
        """Area of a fine mask over that of a region of cells."""
        return float(fine.sum()) / (_FINE**2 * int(region.sum()))

    def covered(self, places: Array, region: Mask) -> Mask:
        """(N,) whether places (N, 2) mm lie in a region of cells; those with a NaN do not."""
        finite = np.isfinite(places).all(-1)
        at = np.rint((np.nan_to_num(places) - self.places[0, 0]) / (self.fine_mm * _FINE)).astype(int)
        inside = finite & (at >= 0).all(-1) & (at < np.array(region.shape[::-1])).all(-1)
        row, column = (np.clip(at[:, k], 0, region.shape[1 - k] - 1) for k in (1, 0))
        return np.asarray(inside & region[row, column])

    def at_points(self, fine: NDArray[Any]) -> NDArray[Any]:
        """Fine values (N,) where the points lay in the first frame."""
        return np.asarray(fine[self._row, self._column])
