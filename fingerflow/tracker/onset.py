"""When a point comes into contact."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

#: Frames in a row that the contact covers a point to count as its onset.
LASTING = 3
_NO_PAIR = complex(np.nan, np.nan)


class Touching(NamedTuple):
    """The touch that N points have in F frames.

    Attributes:
        place: (F, N, 2) mm, of the point at the beginning of its touch, NaN where it has none.
        variance: (F, N) px^2, of the point then.
        touching, begins: (F, N) bool, whether a point has a touch, and whether it begins there.
    """

    place: Array
    variance: Array
    touching: Array
    begins: Array


class Touches:
    """The present touch of each point, run after run of frames.

    A touch of fewer than `LASTING` frames is forgotten: whether the border grazes a point is chance, and the skin moves
    on until it comes to stay. What has come to stay counts, whatever becomes of the contact.

    Attributes:
        length: (N,) frames in a row that the contact has covered each point, `LASTING` once it did for so many.
        start: (N,) number of the frame in which the touch began, -1 for none.
        place: (N, 2) mm, of the point then; variance (N,) px^2.
        first, first_place: the same of the first touch of all.
    """

    def __init__(self, points: int) -> None:
        self.points = points
        self.length = np.zeros(points, np.uint8)
        self.start = np.full(points, -1)
        self.place = np.full((points, 2), np.nan)
        self.variance = np.full(points, np.nan, np.float32)
        self.first = np.full(points, -1)
        self.first_place = np.full((points, 2), np.nan)

    def go_on(self, frames: Array, covered: Array, position: Array, variance: Array) -> Touching:
        """F frames more, by their numbers (F,): whether the contact covers each point (F, N), where these are (F, N, 2)
        mm, NaN where lost, and the variance (F, N) of a component, px^2.
        """
        steps, goes_on = len(frames), self.length > 0
        touching, begins = np.repeat(goes_on[None], steps, axis=0), np.zeros((steps, self.points), dtype=bool)
        place = np.repeat(np.where(goes_on[:, None], self.place, np.nan)[None], steps, axis=0)
        spread = np.repeat(np.where(goes_on, self.variance, np.float32(np.nan))[None], steps, axis=0)
        # Most have come to stay, or are out of the contact in all of these frames.
        some = np.flatnonzero((self.length < LASTING) & (goes_on | covered.any(0)))
        if not len(some):
            return Touching(place, spread, touching, begins)
        number = np.arange(1, steps + 1, dtype=np.int32)[:, None]
        # The frames since the last one without contact, unless it has come to stay.
        left = np.maximum.accumulate(np.where(covered[:, some], 0, number), axis=0)
        length = number - left + np.where(left == 0, self.length[some], 0)
        stays = np.logical_or.accumulate(length >= LASTING, axis=0)
        length = np.where(stays, LASTING, length).astype(np.uint8)
        begin = (length == 1) & (np.concatenate((self.length[None, some], length[:-1])) == 0)
        touching[:, some], begins[:, some] = length > 0, begin
        came = np.flatnonzero(begin.any(0) & (self.first[some] < 0))
        first, points = begin[:, came].argmax(0), some[came]
        self.first[points], self.first_place[points] = frames[first], position[first, points]
        began = np.maximum.accumulate(np.where(begin, number, 0), axis=0)
        here, new, at = length > 0, began > 0, np.maximum(began - 1, 0)
        at = at * self.points + some
        for values, given, none in (
            (_pairs(place), _pairs(position), _NO_PAIR),
            (spread, variance, np.float32(np.nan)),
        ):
            values[:, some] = np.where(here, np.where(new, given.ravel()[at], values[:, some]), none)
        self.start[some] = np.where(new[-1], frames[began[-1] - 1], self.start[some])
        self.length[some], self.place, self.variance = length[-1], place[-1].copy(), spread[-1].copy()
        return Touching(place, spread, touching, begins)


def _pairs(places: Array) -> NDArray[np.complex128]:
    """(...) of (..., 2), in the same memory: NumPy is several times as slow over an axis of two."""
    return places.view(np.complex128)[..., 0]
