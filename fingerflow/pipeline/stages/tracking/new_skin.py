"""Skin that comes into contact and holds no point, because it lay elsewhere when points were chosen.

Whether skin has had its chance is a question of material, not of density: a place x in a picture shows the skin that
lay at X = x - u in the key frame of the nearest point, u the way of that point since; it is new where X lies outside
the region in which points were looked for there. So skin without texture is not searched again and again, and a press,
whose region is that of its largest contact, has no new skin.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

_STEP = 2  # cells: places are looked at so far apart
_AHEAD = 2.0  # times the way since the last look, that skin is expected to go on: the next look is half as far
_STRIDE = 0.25  # windows: upstream of the contact, places from which skin will come are looked at so far apart
Points = NDArray[np.floating]
Mask = NDArray[np.bool_]


class Known(NamedTuple):
    """Points in the present frame.

    Attributes:
        place: (N, 2) px of the topography view, where a point is or is expected.
        start: (N, 2) px, where it was in its key frame.
        tracked: (N,) bool.
        choice: (N,) numbers of the `NewSkin.searched` regions that the points come from.
    """

    place: Points
    start: Points
    tracked: Mask
    choice: NDArray[np.integer]


class NewSkin:
    """Looks for skin in contact, or about to be, that has no points.

    Args:
        topography_to_contact: (2, 3) px to px.
        cell_px: of the contact's cells.
        window_px: of a point in the topography view: skin within half of it is seen by that point.
    """

    def __init__(self, topography_to_contact: NDArray[np.float64], cell_px: int, window_px: int) -> None:
        self._matrix, self._cell, self._window = topography_to_contact, cell_px, window_px
        self._inverse = cv2.invertAffineTransform(topography_to_contact)
        self._per_px = float(np.sqrt(abs(np.linalg.det(topography_to_contact[:, :2]))))  # contact px a topography px
        self.searched: list[Mask] = []  # regions (h, w) of the topography view in which points were looked for
        self._before: tuple[Points, Points] | None = None  # places (N, 2) and the middle of the contact, a look ago

    def begin(self, contact: NDArray[np.floating], place: Points) -> None:
        """Remembers where points (N, 2) px of the topography view were when they were chosen, with cells as `region`
        has them: what moves fast has moved far by the first look.
        """
        touching = contact[::_STEP, ::_STEP] > 0
        if touching.any():
            self._before = self._on_contact(place), self._middle(touching)

    def region(self, contact: NDArray[np.floating], known: Known) -> Mask | None:
        """(h, w) of the topography view: where points are to be chosen in this frame, None where that is not needed.

        They are needed where new skin is in contact, or will be before the next look but one if points and contact go
        on as they did, farther from any point than half a window, over an area of a window or more. They are chosen in
        all new skin that is in contact or lies upstream of it, within a window or as far as skin moves until the next
        look but one: skin that is in contact when its points are chosen has no onset.

        Args:
            contact: (h', w') cells, positive in the gross contact.
            known: all points in this frame.
        """
        touching = contact[::_STEP, ::_STEP] > 0
        if not touching.any() or not known.tracked.any():
            return None
        place = self._on_contact(known.place)  # px of the contact view from here on
        middle = self._middle(touching)
        before, self._before = self._before, (place, middle)
        way = np.zeros_like(place)  # of points against the contact
        if before is not None:
            old = len(before[0])
            way[:old] = (place[:old] - before[0]) - (middle - before[1])
        tracked, far = np.flatnonzero(known.tracked), self._window / 2 * self._per_px
        some = np.flatnonzero(self._may_be_empty(touching, place[tracked], way[tracked], far))
        if not len(some):
            return None
        rows, columns = np.indices(touching.shape)
        at = _looked_at(np.stack((columns, rows), axis=-1).reshape(-1, 2), self._cell)
        tree = cKDTree(place[tracked])
        distance, nearest = tree.query(at[some])
        coming = at[some] + _AHEAD * way[tracked[nearest]]
        empty = (self._in(touching, at[some]) | self._in(touching, coming)) & (distance > far)
        if not empty.any():
            return None
        some, nearest = some[empty], tracked[nearest[empty]]
        empty = cKDTree(place).query(at[some])[0] > far
        empty[empty] = self._is_new(at[some[empty]], nearest[empty], known)
        if empty.sum() * (_STEP * self._cell) ** 2 < (self._window * self._per_px) ** 2:
            return None
        nearest = tracked[tree.query(at)[1]]
        length = np.linalg.norm(way[nearest], axis=1, keepdims=True)
        downstream = np.where(length > 0, way[nearest] / np.maximum(length, 1e-9), 0.0)
        window = self._window * self._per_px
        reach = np.clip(_AHEAD * length, window, window + self._cell * _STEP * max(touching.shape))
        steps = np.arange(0, reach.max() + _STRIDE * window, _STRIDE * window)
        wanted = np.any([self._in(touching, at + np.minimum(step, reach) * downstream) for step in steps], axis=0)
        wanted[wanted] = self._is_new(at[wanted], nearest[wanted], known)
        return self._on_topography(wanted.reshape(touching.shape)) & ~self._beside(known.place)

    def _may_be_empty(self, touching: Mask, place: Points, way: Points, far: float) -> Mask:
        """Cells, in a row, that touch or may be about to, and no point (N, 2) is within `far` of them.

        In a press there are hardly any: the nearest points are searched for these alone.
        """
        side = self._cell * _STEP
        reach = int(_AHEAD * np.nanmax(np.abs(way), initial=0.0) / side) + 1
        window = np.ones((2 * min(reach, max(touching.shape)) + 1,) * 2, np.uint8)
        empty = cv2.dilate(touching.astype(np.uint8), window, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
        # Cells around that of each point that may be looked at within this distance of it.
        around = np.arange(-int(far / side) - 1, int(far / side) + 2)
        cell = np.floor((place + 0.5) / side).astype(int)
        column, row = (cell[:, k, None] + around for k in (0, 1))  # (N, K)
        across, down = ((_looked_at(some, self._cell) - place[:, k, None]) ** 2 for k, some in enumerate((column, row)))
        near = down[:, :, None] + across[:, None] <= far**2
        near &= ((row >= 0) & (row < touching.shape[0]))[:, :, None]
        near &= ((column >= 0) & (column < touching.shape[1]))[:, None]
        number = row[:, :, None] * touching.shape[1] + column[:, None]
        result: Mask = empty.ravel()
        result[number[near]] = False
        return result

    def _on_contact(self, place: Points) -> Points:
        result: Points = place @ self._matrix[:, :2].T + self._matrix[:, 2]
        return result

    def _middle(self, touching: Mask) -> Points:
        lines = touching.sum(0), touching.sum(1)  # of columns, of rows
        total = lines[0].sum()
        result: Points = np.array([one @ np.arange(len(one)) / total for one in lines]) * self._cell * _STEP
        return result

    def _in(self, touching: Mask, at: Points) -> Mask:
        column, row = np.floor((at + 0.5) / (self._cell * _STEP)).astype(int).T
        inside = (row >= 0) & (column >= 0) & (row < touching.shape[0]) & (column < touching.shape[1])
        result: Mask = inside & touching[np.where(inside, row, 0), np.where(inside, column, 0)]
        return result

    def _is_new(self, at: Points, nearest: NDArray[np.integer], known: Known) -> Mask:
        """Whether skin at (K, 2) px of the contact view lay outside the region where its nearest point was chosen."""
        was = at @ self._inverse[:, :2].T + self._inverse[:, 2] - (known.place - known.start)[nearest]
        column, row = np.rint(was).astype(int).T
        height, width = self.searched[0].shape
        inside = (row >= 0) & (column >= 0) & (row < height) & (column < width)
        regions = np.stack(self.searched)
        had = regions[known.choice[nearest], np.where(inside, row, 0), np.where(inside, column, 0)]
        result: Mask = ~(inside & had)
        return result

    def _on_topography(self, cells: Mask) -> Mask:
        side = self._cell * _STEP
        picture = np.kron(cells.astype(np.uint8), np.ones((side, side), np.uint8))
        height, width = self.searched[0].shape
        onto = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        warped = cv2.warpAffine(np.asarray(picture, np.uint8), self._matrix, (width, height), flags=onto)
        return np.asarray(warped > 0)

    def _beside(self, place: Points) -> Mask:
        """Px (h, w) that are nearer to a point than half the usual distance of points."""
        height, width = self.searched[0].shape
        column, row = np.rint(place[np.isfinite(place).all(1)]).astype(int).T
        inside = (row >= 0) & (column >= 0) & (row < height) & (column < width)
        away = np.ones((height, width), np.uint8)
        away[row[inside], column[inside]] = 0
        distance = cv2.distanceTransform(away, cv2.DIST_L2, 5)
        spacing = float(np.median(cKDTree(place).query(place, k=2)[0][:, 1]))
        return np.asarray(distance < spacing / 2)


def _looked_at(number: NDArray[np.integer], cell_px: int) -> Points:
    """Px along an axis: the middle of the cell that stands for `_STEP` of them."""
    result: Points = (number * _STEP + 0.5) * cell_px - 0.5
    return result
