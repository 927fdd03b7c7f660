"""Search for lost points, which registration did not find near their predicted positions."""

from collections.abc import Callable

import numpy as np

from fingerflow.engines.engine import TRACKED, TrackedPoints, reject
from fingerflow.kernels.array_types import Array
from fingerflow.kernels.tracking_limits import TrackStatus

_NOT_CONVERGED = int(TrackStatus.NOT_CONVERGED)
#: Function that tracks rows (L,) near places (L, 2) px and returns the points found (1, L).
Track = Callable[[Array, Array], TrackedPoints]
#: Function that returns the places (L, 2) px of rows (L,) found near guesses (L, 2), and whether a search back from
#: there returns to the start (L,).
Search = Callable[[Array, Array], tuple[Array, Array]]

ROUNDS = 3  # largest number of searches in a frame
_YIELD = 0.25  # share of the searched points that must be found for another round to follow
_NEARER = 0.5  # px, distance from the guess below which tracking again would find the same


def lost_points(status: Array) -> Array:
    """Return a mask (...) of the points to search for, by their tracking status: textured and inside the frame, but
    either not found or found and rejected.
    """
    return status >= _NOT_CONVERGED


def recover(
    points: TrackedPoints, guess: Array, searchable: Array, track: Track, search: Search, most: int | None = None,
    by_neighbours: Callable[[TrackedPoints], Array] | None = None,
) -> tuple[TrackedPoints, Array]:  # fmt: skip
    """Recover lost points of a frame (1, N) by an exhaustive search around guessed positions (N, 2); return all points,
    and which of them (N,) were searched for, or tracked again where their neighbours predict them.

    If more than `most` points are lost, a round searches for a sample of them spread over the view. The others are then
    tracked where their neighbours predict them. There are up to three rounds: after a jump of the skin, a few points
    give the displacement of all.

    Args:
        searchable: (N,) points to search for if they are lost.
        track: tracks some rows in the frame.
        search: searches for some rows around their guesses, as `Engine.search`.
        most: largest number of points searched for in one round; None for all.
        by_neighbours: returns positions (N, 2) px predicted from neighbours, given the points found so far.
    """
    searched = np.zeros(len(searchable), dtype=bool)
    left = searchable & lost_points(points.status[0])
    for _ in range(ROUNDS):
        rows = (left & lost_points(points.status[0])).nonzero()[0]
        if not len(rows):
            break
        sample = rows
        if most is not None and len(rows) > most:
            # Points are ordered by strength, which is unrelated to position: equal steps sample the whole view.
            sample = rows[np.linspace(0, len(rows) - 1, most).round().astype(int)]
        left[sample] = False
        positions, returns = search(sample, guess[sample])
        points = replaced(points, sample, _reject_unreturned(track(positions, sample), returns, guess[sample]))
        searched[sample] = True
        if len(sample) == len(rows) or by_neighbours is None:
            break
        if np.mean(points.status[0, sample] == TRACKED) < _YIELD:
            break
        positions = by_neighbours(points)
        away = np.abs(positions - guess).max(-1) > _NEARER  # False where the position is unknown
        predicted = (searchable & lost_points(points.status[0]) & away).nonzero()[0]
        if len(predicted):
            points = replaced(points, predicted, track(positions[predicted], predicted))
            searched[predicted] = True
    return points, searched


def _reject_unreturned(points: TrackedPoints, returns: Array, guess: Array) -> TrackedPoints:
    """Reject points (1, L) whose backward search does not lead back to the start, with the status FORWARD_BACKWARD.

    `returns` is (L,). Each point is searched for backward, independently of the forward search. It returns if it misses
    the start by at most the forward-backward limit plus 1 px, the accuracy of a search.
    """
    wrong = ~returns[None] & (points.status == TRACKED)
    if not wrong.any():
        return points
    estimate = np.where(wrong[..., None], guess, points.estimate)
    return reject(points, wrong, TrackStatus.FORWARD_BACKWARD)._replace(estimate=estimate)


def replaced(points: TrackedPoints, rows: Array, again: TrackedPoints) -> TrackedPoints:
    """Return the tracking results `points` (n, N) with those of the L points of indices `rows` replaced by `again` (n,
    L).
    """
    result = TrackedPoints(*(values.copy() for values in points))
    for whole, part in zip(result, again, strict=True):
        whole[:, rows] = part
    return result
