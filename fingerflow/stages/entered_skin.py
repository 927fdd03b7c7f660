"""Skin that moved into the contact, where displacement by the places of onset has no gradient.

Where a contact grows over skin, neighbours touch at places as far apart as they are, and the gradient of displacement
by the places of onset is the usual one. Skin that moves in over a border at rest touches along one line: an area of it
has places of onset without an area, and no gradient by them (`synthetic.Truth.gradient` is NaN there).
What can be said of such skin is how it has deformed since its own entry, all neighbours counted from that moment:
with F the gradient of its position by the place in a common frame, F(t) F(entry)^-1 - I.
"""

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError, cKDTree
from torch import Tensor

from fingerflow.ops.entry import MOVED, NEAR
from fingerflow.ops.local_fit import local_gradients
from fingerflow.store import Values

LEAST_AREA = 0.5  # of places of onset over that of the skin: below, when points entered shapes it more than the skin
_VOTERS = 3  # neighbours that a point is compared with
_FRAMES = 64  # read at a time
Points = NDArray[np.float64]
Numbers = NDArray[np.integer]


def moved_in(position: Values, places: Points, onset: Numbers, reference: Points, gauge_mm: float) -> NDArray[np.bool_]:
    """Which points (N,) came into contact by moving into it.

    Those whose neighbours' places of onset span less than `LEAST_AREA` of the area of the skin, by local fits among
    points that have an onset after the first one. And those of which the skin around that touches already has moved by
    an eighth of the gauge length since its own onset, in the median: where a contact grows at twice the speed of the
    skin or faster, it has moved by less; it tells of single points, and of a narrow band along a border, which span no
    area. And those whose three nearest among the points that touch after the first frame are mostly found so: skin
    enters along a stretch of the border, and a single point of it that counted from the place of its onset would give
    all fits over it the way that it moved before (on a slide two points of 540 put the median up by 4 um/mm of 25).
    A single point among skin that touches in the first frame is not told where that has moved by less: on a slide two
    such points put the median up by 2 um/mm.

    Args:
        position: (frames, N, 2) mm.
        places: (N, 2) mm, in a frame that is the same for all.
        onset: (N,) frame, -1 for none.
        reference: (N, 2) mm, places of onset.
        gauge_mm: over which a fit is made.
    """
    known = np.isfinite(places + reference).all(1) & (onset >= 0)
    counts = known & (onset > onset[known].min(initial=np.iinfo(np.int32).max))
    if counts.sum() < 3:
        return np.zeros(len(onset), dtype=bool)
    shift = np.where(counts[:, None], reference - places, np.nan)
    fit = local_gradients(torch.from_numpy(places)[None], torch.from_numpy(shift)[None], gauge_length=gauge_mm)
    identity = torch.eye(2, dtype=fit.gradient.dtype, device=fit.gradient.device)
    area = torch.linalg.det(identity + fit.gradient[0]).numpy()
    moved = _neighbours_moved(position, places, onset, reference, gauge_mm, counts)
    return with_neighbours(counts & ((area < LEAST_AREA) | (moved > MOVED * gauge_mm)), places, counts, NEAR * gauge_mm)


def with_neighbours(
    found: NDArray[np.bool_], places: Points, among: NDArray[np.bool_], reach_mm: float
) -> NDArray[np.bool_]:
    """``found`` (N,), and those `among` the points of which most of the three nearest within ``reach_mm`` are found."""
    some = np.flatnonzero(among)
    if len(some) <= _VOTERS:
        return found
    apart, near = cKDTree(places[some]).query(places[some], k=np.arange(2, _VOTERS + 2))
    votes = (found[some][near] & (apart < reach_mm)).sum(1)
    result = found.copy()
    result[some[votes > _VOTERS / 2]] = True
    return result


def _neighbours_moved(
    position: Values, places: Points, onset: Numbers, reference: Points, gauge_mm: float, wanted: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """(N,) mm, median of how far points within half a gauge length that touched before had moved since, at the onset of
    each that is `wanted`; NaN where there is none.
    """
    moved = np.full(len(onset), np.nan)
    known = np.isfinite(places + reference).all(1) & (onset >= 0)
    here, touched = np.flatnonzero(wanted), np.flatnonzero(known)
    near = cKDTree(places[touched]).query_ball_point(places[here], NEAR * gauge_mm)
    around = {point: touched[some] for point, some in zip(here, near, strict=True)}
    for first in range(0, position.shape[0], _FRAMES):
        rows: Points | None = None
        for point in here[(onset[here] >= first) & (onset[here] < first + _FRAMES)]:
            if rows is None:
                rows = position[slice(first, min(first + _FRAMES, position.shape[0]))]
            before = around[point][onset[around[point]] < onset[point]]
            way = np.linalg.norm(rows[onset[point] - first, before] - reference[before], axis=1)
            way = np.sort(way[np.isfinite(way)])  # np.nanmedian takes ten times as long for so few
            if len(way):
                moved[point] = (way[(len(way) - 1) // 2] + way[len(way) // 2]) / 2
    return moved


class SinceEntry(NamedTuple):
    """Of n frames and E points that moved in; NaN before the entry and where too little is known."""

    gradient: Tensor  # (n, E, 2, 2) of the displacement since the own entry, by the places then
    covariance: Tensor  # (n, E, 2, 2, 2, 2), to first order, as if the skin had not deformed before


class EntryGradients:
    """Gradients of the displacement since each point's own entry; frames come in the order of time."""

    def __init__(self, entered: Numbers, places: Points, onset: Numbers, gauge_mm: float) -> None:
        """``entered`` (E,) are numbers of points; the others as for `moved_in`."""
        self.entered, self._onset, self._gauge = entered, onset[entered], gauge_mm
        known = np.flatnonzero(np.isfinite(places).all(1))
        apart, _ = cKDTree(places[entered]).query(places[known])
        self._near = known[apart <= gauge_mm / 2]  # all that say something of their surroundings
        self._places, self._queries = (torch.from_numpy(places[some])[None] for some in (self._near, entered))
        self._begun = self._places.new_full((len(entered), 2, 2), torch.nan)
        self._begun_covariance = self._places.new_full((len(entered), 2, 2, 2, 2), torch.nan)

    def at(self, frames: Numbers, position: Points, variance: NDArray[np.floating]) -> SinceEntry:
        """In these frames (n,), from positions (n, N, 2) mm and the variance (n, N) mm^2 of a component against the
        frame in which points were chosen. Half of it is that frame's, the same at all times.
        """
        moved = torch.from_numpy(position[:, self._near]) - self._places
        noise = torch.from_numpy(variance[:, self._near].astype(np.float64) / 2)
        fit = local_gradients(self._places, moved, self._queries, gauge_length=self._gauge, variance=noise)
        assert fit.covariance is not None
        identity = torch.eye(2, dtype=torch.float64, device=self._places.device)
        now = identity + fit.gradient
        for k, frame in enumerate(frames):
            enter = np.flatnonzero(self._onset == frame)
            self._begun[enter], self._begun_covariance[enter] = now[k, enter], fit.covariance[k, enter]
        return SinceEntry(now @ _inverse(self._begun) - identity, fit.covariance + self._begun_covariance)


class EntryTriangles(NamedTuple):
    """Triangles (M, 3) of points of which one at least moved in, and the frame (M,) from which each counts: in which
    the last of its points has touched.
    """

    corners: NDArray[np.int32]
    begins: NDArray[np.int64]


def entry_triangles(entered: Numbers, places: Points, onset: Numbers) -> EntryTriangles:
    """Delaunay triangles of points that have touched, by their ``places`` (N, 2) in a late frame."""
    triangles = triangulate(np.where((onset >= 0)[:, None], places, np.nan))
    triangles = triangles[np.isin(triangles, entered).any(1)]
    return EntryTriangles(triangles, onset[triangles].max(1, initial=0).astype(np.int64))


def triangulate(reference: Points) -> NDArray[np.int32]:
    """Delaunay triangles (M, 3) of the finite points; none where fewer than three of them span an area."""
    finite = np.flatnonzero(np.isfinite(reference).all(-1))
    if len(finite) < 3:
        return np.zeros((0, 3), dtype=np.int32)
    try:
        result: NDArray[np.int32] = finite[Delaunay(reference[finite]).simplices].astype(np.int32)
        return result
    except QhullError:  # all on one line
        return np.zeros((0, 3), dtype=np.int32)


def _inverse(matrix: Tensor) -> Tensor:
    """Of 2 x 2 matrices; NaN passes."""
    (a, b), (c, d) = (row.unbind(-1) for row in matrix.unbind(-2))
    adjugate = torch.stack((torch.stack((d, -b), dim=-1), torch.stack((-c, a), dim=-1)), dim=-2)
    return adjugate / (a * d - b * c)[..., None, None]
