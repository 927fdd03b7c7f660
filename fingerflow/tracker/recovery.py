"""Points that a frame does not show where they are expected, searched for again."""

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
_YIELD = 0.25  # share of the points searched for that is found, below which no other search follows
_NEARER = 0.5  # px from where a point was looked for before, below which nothing else would be found


class Recovered(NamedTuple):
    """What a frame shows after a search.

    Attributes:
        found: of (1, N) points.
        searched: (N,) points that nothing but a search, or their neighbours after one, has found.
    """

    found: FoundPoints
    searched: Array


def lost_points(status: Array) -> Array:
    """(...) bool, which points with texture inside the frame were not found, or not where they can be."""
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
    """Searches for the points of a frame (1, N) that are lost, around their guesses (N, 2).

    Where no more than `most` may be searched for in one round, those that lie all over the view are, and the others are
    looked for where their neighbours then say, for up to three rounds: after a jump of the skin a few tell the way of
    all.

    Args:
        key, start: key frame of the templates and their places (N, 2) px in it.
        wanted: (N,) points that are worth a search.
        most: points that are searched for in one round; None for all.
        by_neighbours: (N, 2) px where neighbours expect points, from what is found so far.
    """
    searched = np.zeros(len(start), dtype=bool)
    left = wanted & lost_points(found.status[0])
    for _ in range(ROUNDS):
        rows = np.flatnonzero(left & lost_points(found.status[0]))
        if not len(rows):
            break
        some = rows
        if most is not None and len(rows) > most:
            # Points come in the order of their strength, which is none of places: these lie all over.
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
    """The same, some rows searched for within `search_px` of their guesses.

    Searched for backward too, without knowing the way there: one that leads elsewhere by more than the limit, and the
    pixel that a search is good to, has the status FORWARD_BACKWARD.
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
    """What was found of (1, N) points, with what was found again of some rows."""
    result = FoundPoints(*(one.copy() for one in found))
    for whole, part in zip(result, again, strict=True):
        whole[:, rows] = part
    return result
