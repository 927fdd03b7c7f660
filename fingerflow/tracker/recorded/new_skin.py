"""Detection of skin in contact without tracked points, because it was outside the region where points were seeded.

The criterion is material, not density. A position x in a picture shows the skin that lay at X = x - u in the key frame
of the nearest point, where u is the displacement of that point since. The skin is new if X lies outside the region
in which points were seeded there. So skin without texture is not searched repeatedly, and a press, whose region is that
of its largest contact, has no new skin.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fingerflow.kernels.array_types import Array, Mask, Numbers, Points
from fingerflow.recordings.lens import Geometry

_STEP = 2  # cells between sampled positions
_AHEAD = 2.0  # prediction time in intervals between calls: until the next call but one
LEFT = 0.1  # share of tracked points below which their skin counts as gone
_STRIDE = 0.25  # windows, distance between samples upstream of the contact


class NewSkin:
    """Detector of skin without tracked points that is in contact or about to come into contact.

    Args:
        geometry: of the views.
        cell_px: side of the contact's cells.
        window_px: window of a point in the topographic view: the point covers skin within half of it.
    """

    def __init__(self, geometry: Geometry, cell_px: int, window_px: int) -> None:
        self._geometry, self._cell, self._window = geometry, cell_px, window_px
        self._side = cell_px * _STEP  # px, distance between sampled positions
        self._matrix, self._per_px = geometry.topography_to_contact, geometry.magnification
        self._inverse = cv2.invertAffineTransform(self._matrix)
        self.searched: list[Mask] = []  # regions (h, w) of the topographic view in which points were seeded
        self._before: tuple[Points, Points] | None = None  # (N, 2) positions and centre of contact at the last call

    def begin(self, region: Mask, contact: Array, positions: Points) -> None:
        """Store the `region` (h, w) and the `positions` (N, 2), px of the topographic view, in which the first points
        were seeded; these are the positions before the first call of `region`.

        `contact` has cells as for `region`. Fast points have moved far by the first call of `region`.
        """
        self.searched.append(region)
        touching = contact[::_STEP, ::_STEP] > 0
        if touching.any():
            self._before = self._on_contact(positions), self._middle(touching)

    def region(self, contact: Array, pixels: Points, moved: Points, tracked: Mask, seeding: Numbers) -> Mask | None:
        """Return the mask (h, w) of the topographic view in which new points must be seeded; None if there is none.

        Where hardly a point is left, as after a finger has been lifted and touches elsewhere, all skin in contact is
        new but for that around the points which are left.

        Points are needed where new skin is in contact, or will be before the next call but one if points and contact
        keep their speeds. It must lie farther than half a window from any point, over an area of at least a window.
        Points are then seeded in all new skin that is in contact or upstream of it, within a window or the distance
        that skin moves until the next call but one: skin that is in contact when its points are seeded has no onset.

        Args:
            contact: (h', w') cells, positive in the gross contact.
            pixels: (N, 2) px of the topographic view, measured or expected positions of all points in this frame.
            moved: (N, 2) px, their displacement since the frame in which each was seeded.
            tracked: (N,) bool.
            seeding: (N,) indices of the regions `searched` in which the points were seeded.
        """
        touching = contact[::_STEP, ::_STEP] > 0
        if not touching.any():
            return None
        if tracked.sum() < LEFT * len(tracked):
            self._before = None
            return self._around(touching) & ~self._near_points(pixels[tracked])
        position = self._on_contact(pixels)  # from here on in px of the contact view
        middle = self._middle(touching)
        before, self._before = self._before, (position, middle)
        way = np.zeros_like(position)  # px, displacement of points relative to the contact
        if before is not None:
            old = len(before[0])
            way[:old] = (position[:old] - before[0]) - (middle - before[1])
        followed, window = np.flatnonzero(tracked), self._window * self._per_px
        # Skin that touches, or may soon, farther than half a window from any point: a press has hardly any.
        ahead = int(_AHEAD * np.nanmax(np.abs(way[followed]), initial=0.0) / self._side) + 1
        square = np.ones((2 * min(ahead, max(touching.shape)) + 1,) * 2, np.uint8)
        soon = cv2.dilate(touching.astype(np.uint8), square) > 0
        # Look first at distances between cells, which take a tenth of the time.
        if self._is_small(soon & self._far(position, contact.shape, window / 2), window):
            return None
        at = np.argwhere(np.ones_like(touching))[:, ::-1] * self._side + (self._cell - 1) / 2  # (K, 2), of every cell
        bare = soon.ravel() & (np.hypot(*(at - position[self._nearest(position, contact.shape)]).T) > window / 2)
        if self._is_small(bare, window):
            return None
        nearest = followed[self._nearest(position[followed], contact.shape)]
        bare &= self._in(touching, at) | self._in(touching, at + _AHEAD * way[nearest])
        is_new = self._is_new(at, moved[nearest], seeding[nearest])
        bare &= is_new
        if self._is_small(bare, window):
            return None
        length = np.linalg.norm(way[nearest], axis=1, keepdims=True)
        downstream = np.where(length > 0, way[nearest] / np.maximum(length, 1e-9), 0.0)
        reach = np.clip(_AHEAD * length, window, window + self._side * max(touching.shape))
        steps = np.arange(0, reach.max() + _STRIDE * window, _STRIDE * window)
        seeded = np.any([self._in(touching, at + np.minimum(step, reach) * downstream) for step in steps], axis=0)
        return self._on_topography((seeded & is_new).reshape(touching.shape)) & ~self._near_points(pixels)

    def _nearest(self, position: Points, shape: tuple[int, ...]) -> Numbers:
        """Return, for every second cell of every second row, the index (K,) of the nearest of the points `position`
        (N, 2) px, exact to half a cell; `shape` is that of all cells.
        """
        return distances(self._cells(position), shape)[1][::_STEP, ::_STEP].ravel()

    def _far(self, position: Points, shape: tuple[int, ...], distance: float) -> Mask:
        """Return, for every second cell of every second row, whether the cells of all points `position` (N, 2) px lie
        farther away than `distance` (px).
        """
        reach = int(distance / self._cell)
        disc = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1]) * self._cell <= distance
        far = cv2.erode(_without(self._cells(position), shape)[0], disc.astype(np.uint8))
        return np.asarray(far[::_STEP, ::_STEP] > 0)

    def _is_small(self, cells: Mask, window: float) -> bool:
        return bool(np.count_nonzero(cells) * self._side**2 < window**2)

    def _cells(self, position: Points) -> Points:
        """Return positions (N, 2) px of the contact view in cells."""
        return (position + 0.5) / self._cell - 0.5

    def _around(self, touching: Mask) -> Mask:
        """Return the mask (h, w) of the topographic view around a contact that has just begun, as far as the first
        seeding region extended (its radius).

        The contact is taken to grow as large as that one.
        """
        radius = max(self._window, np.sqrt(self.searched[0].sum() / np.pi)) * self._per_px / self._side
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * round(radius) + 1,) * 2)
        return self._on_topography(cv2.dilate(touching.astype(np.uint8), disc) > 0)

    def _on_contact(self, position: Points) -> Points:
        return position @ self._matrix[:, :2].T + self._matrix[:, 2]

    def _middle(self, touching: Mask) -> Points:
        lines = touching.sum(0), touching.sum(1)  # number of touching cells by column, and by row
        return np.array([counts @ np.arange(len(counts)) / lines[0].sum() for counts in lines]) * self._side

    def _in(self, touching: Mask, at: Array) -> Mask:
        column, row = np.floor((at + 0.5) / self._side).astype(int).T
        return _look_up(touching, row, column)

    def _is_new(self, at: Array, moved: Points, seeding: Numbers) -> Mask:
        """Return the mask (K,) of positions `at` (K, 2) px of the contact view whose skin lay outside the region in
        which the nearest point was seeded, at the time of that seeding.

        The skin is traced back by the displacement `moved` (K, 2) px of the nearest point since then.
        """
        column, row = np.rint(at @ self._inverse[:, :2].T + self._inverse[:, 2] - moved).astype(int).T
        return ~_look_up(np.stack(self.searched), seeding, row, column)

    def _on_topography(self, cells: Mask) -> Mask:
        return on_topography(cells.repeat(self._side, 0).repeat(self._side, 1), self._geometry)

    def _near_points(self, position: Points) -> Mask:
        """Return the mask (h, w) of the pixels of the topographic view that lie nearer to a point of `position` (N, 2)
        px than half the median spacing of the points.
        """
        if len(position) < 2:
            return np.zeros(self.searched[0].shape, dtype=bool)
        spacing = np.median(cKDTree(position).query(position, k=2)[0][:, 1])
        return distances(position, self.searched[0].shape)[0] < spacing / 2


def distances(points: Array, shape: tuple[int, ...]) -> tuple[Array, Numbers]:
    """Return, for every pixel of a picture, its distance (h, w) px from the nearest point, exact to half a pixel, and
    the index (h, w) of that point; points (N, 2) px outside the picture do not count.
    """
    away, inside, at = _without(points, shape)
    distance, labels = cv2.distanceTransformWithLabels(away, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    point = np.zeros(labels.max() + 1, np.intp)
    point[labels[at]] = inside
    return np.asarray(distance, np.float32), point[labels]


def _without(points: Array, shape: tuple[int, ...]) -> tuple[NDArray[np.uint8], Numbers, tuple[Numbers, ...]]:
    """Return a picture that is 0 at the pixels nearest to points (N, 2) px, else 1, the indices (K,) of the points
    inside it, and their rows and columns.
    """
    column, row = np.rint(points).astype(int).T
    inside = np.flatnonzero((column >= 0) & (row >= 0) & (column < shape[1]) & (row < shape[0]))
    away, at = np.ones(shape, np.uint8), (row[inside], column[inside])
    away[at] = 0
    return away, inside, at


def _look_up(mask: Mask, *numbers: Numbers) -> Mask:
    """Return the values (K,) of a mask at indices (K,) along each of its axes; False outside the mask."""
    inside = np.all([(index >= 0) & (index < side) for index, side in zip(numbers, mask.shape, strict=True)], axis=0)
    return inside & mask[tuple(np.where(inside, index, 0) for index in numbers)]


def on_topography(region: Mask, geometry: Geometry) -> Mask:
    """Return a mask of the contact view as a mask (h, w) of the topographic view."""
    assert geometry.topography is not None, "points are tracked in it"
    flags, size = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP, geometry.topography.shape[::-1]
    return cv2.warpAffine(region.astype(np.uint8), geometry.topography_to_contact, size, flags=flags) > 0


def touching_skin(margin: Array, cell_px: int, geometry: Geometry) -> Mask:
    """Return the mask (h, w) of the topographic view of the cells of the contact view, of `cell_px` px, that are
    positive in `margin`.
    """
    assert geometry.contact is not None, "contact is measured in it"
    rows, columns = geometry.contact.shape
    cells = (margin > 0).repeat(cell_px, 0).repeat(cell_px, 1)
    return on_topography(cells[:rows, :columns], geometry)
