"""Lost-point recovery: a search for points that were not found near their predictions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fingerflow.engines.engine import Engine, Followed, FoundPoints, Images, KeyFrame, TemplateBuffers
from fingerflow.engines.together import Call, Steps
from fingerflow.kernels.tracking_limits import TrackStatus

Array = NDArray[Any]

ROUNDS = 3  # searches of a frame, at most
_YIELD = 0.25  # share of the points searched for that are found, below which no other round follows
_NEARER = 0.5  # px from the guess, below which tracking again would find nothing else


class Recovered(NamedTuple):
    """Result of a frame after lost-point recovery.

    Attributes:
        found: (1, N) points.
        searched: (N,) points that were searched for, or tracked again where their neighbours predict them.
    """

    found: FoundPoints
    searched: Array


def lost_points(status: Array) -> Array:
    """Return a mask (...) of the points with texture inside the frame that were not found, or found and rejected."""
    lost: Array = status >= TrackStatus.NOT_CONVERGED
    return lost


def recover(
    engine: Engine,
    templates: TemplateBuffers,
    key: KeyFrame,
    start: Array,
    image: Images,
    found: FoundPoints,
    guess: Array,
    wanted: Array,
    most: int | None = None,
    by_neighbours: Callable[[FoundPoints], Steps[Array]] | None = None,
) -> Steps[Recovered]:
    """Search for the lost points of a frame (1, N) around their guesses (N, 2).

    If more than `most` points are lost, a round searches for a sample of them spread over the view. The others are then
    tracked where their neighbours predict them. There are up to three rounds: after a jump of the skin, a few points
    give the displacement of all.

    Args:
        key, start: key frame of the templates and their reference positions (N, 2) px in it.
        wanted: (N,) points to search for if they are lost.
        most: largest number of points searched for in one round; None for all.
        by_neighbours: returns positions (N, 2) px predicted from neighbours, given the points found so far.
    """
    searched = np.zeros(len(start), dtype=bool)
    left = wanted & lost_points(found.status[0])
    for _ in range(ROUNDS):
        rows = np.flatnonzero(left & lost_points(found.status[0]))
        if not len(rows):
            break
        some = rows
        if most is not None and len(rows) > most:
            # Points are ordered by strength, which is unrelated to position: equal steps sample the whole view.
            some = rows[np.linspace(0, len(rows) - 1, most).round().astype(int)]
        left[some] = False
        found = yield from _searched(engine, templates, key, start, image, found, guess, some)
        searched[some] = True
        if len(some) == len(rows) or by_neighbours is None:
            break
        if np.mean(found.status[0, some] == TrackStatus.TRACKED) < _YIELD:
            break
        places = yield from by_neighbours(found)
        away = np.abs(places - guess).max(-1) > _NEARER  # False where nothing is known
        others = np.flatnonzero(wanted & lost_points(found.status[0]) & away)
        if len(others):
            again = yield from _look(engine, templates, image, places[others], others)
            found = _replaced(found, others, again)
            searched[others] = True
    return Recovered(found, searched)


def _look(engine: Engine, templates: TemplateBuffers, image: Images, places: Array, rows: Array) -> Steps[FoundPoints]:
    at_rest = np.zeros((len(rows), 2), np.float32)
    followed: Followed = yield Call(engine.follow, (templates, image, places.astype(np.float32), at_rest, rows))
    return followed.found


def _searched(
    engine: Engine,
    templates: TemplateBuffers,
    key: KeyFrame,
    start: Array,
    image: Images,
    found: FoundPoints,
    guess: Array,
    rows: Array,
) -> Steps[FoundPoints]:
    """Search for some rows within `search_px` of their guesses and return the updated result.

    Each point is also searched for backward, independently of the forward search. If this misses the start by more than
    the forward-backward limit plus 1 px, the accuracy of a search, its status is FORWARD_BACKWARD.
    """
    near = guess[rows]
    places, returns = engine.search(key, image, start[rows], near)
    again = yield from _look(engine, templates, image, places, rows)
    wrong = ~returns & (again.status[0] == TrackStatus.TRACKED)
    if wrong.any():
        again.points[0, wrong] = again.covariance[0, wrong] = np.nan
        again.status[0, wrong] = TrackStatus.FORWARD_BACKWARD
        again.estimate[0, wrong] = near[wrong]
    return _replaced(found, rows, again)


def _replaced(found: FoundPoints, rows: Array, again: FoundPoints) -> FoundPoints:
    """Return the result of (1, N) points with some rows replaced by `again`."""
    result = FoundPoints(*(one.copy() for one in found))
    for whole, part in zip(result, again, strict=True):
        whole[:, rows] = part
    return result
