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
from fingerflow.stages.border import BORDER_MM, Border
from fingerflow.store import Values

LEAST_AREA = 0.5  # of places of onset over that of the skin: below, when points entered shapes it more than the skin
_VOTERS = 3  # neighbours that a point is compared with
_FRAMES = 64  # read at a time
Points = NDArray[np.float64]
Numbers = NDArray[np.integer]


def moved_in(
    position: Values, places: Points, onset: Numbers, reference: Points, gauge_mm: float, border: Border
) -> NDArray[np.bool_]:
    """Which points (N,) came into contact by moving into it.

    Those that have an onset after the first one, and before it moved over the glass by more than half of what border
    and point approached each other. Neighbours enter one after the other as the border comes over them, and the places
    of their onsets are off by what they move between: that is the strain which counting from there adds, and where it
    is a half it is when points entered that shapes displacement more than the skin. It holds where a border rests over
    skin that slides in, where skin runs along it, and where both move together and a point at the border is told late.

    It is looked at over the last eighth of the gauge length that a point has moved before its onset, or all that is
    known of it where that is less; below what the place of the border is uncertain by nothing is told.
    A contact that was not there when the point began to move has grown over it.

    And those of which most neighbours are found so, for points of which too little is known.

    Args:
        position: (frames, N, 2) mm.
        places: (N, 2) mm, in a frame that is the same for all.
        onset: (N,) frame, -1 for none.
        reference: (N, 2) mm, places of onset.
        gauge_mm: over which a fit is made.
        border: of the gross contact in the same frames.
    """
    known = np.isfinite(places + reference).all(1) & (onset >= 0)
    counts = known & (onset > onset[known].min(initial=np.iinfo(np.int32).max))
    here = np.flatnonzero(counts)
    way, inside, then = np.full((3, len(here)), np.nan)
    for first in range(0, position.shape[0] if len(here) else 0, _FRAMES):
        frames = slice(first, min(first + _FRAMES, position.shape[0]))
        rows = position[frames].take(here, axis=1)
        way_x, way_y = (rows[..., k] - reference[here, k] for k in range(2))  # NumPy is slow over an axis of two
        moved, depth = np.sqrt(way_x * way_x + way_y * way_y), border.at(frames).inside(rows)
        number = np.arange(frames.start, frames.stop)[:, None]
        before = (number < onset[here]) & np.isfinite(moved)
        far = before & (moved >= MOVED * gauge_mm)
        row = np.where(far.any(0), len(far) - 1 - far[::-1].argmax(0), before.argmax(0))
        some = np.flatnonzero(far.any(0) | (before.any(0) & np.isnan(way)))
        way[some], inside[some] = moved[row[some], some], depth[row[some], some]
        at = np.flatnonzero((onset[here] >= frames.start) & (onset[here] < frames.stop))
        then[at] = depth[onset[here][at] - first, at]
    found = np.zeros(len(onset), dtype=bool)
    found[here] = (way > BORDER_MM) & (LEAST_AREA * (then - inside) < way)
    return with_neighbours(found, places, counts, NEAR * gauge_mm)


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
