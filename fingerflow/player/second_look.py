"""A frame in which many points are lost at once, looked at again."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from .arrays import Array
from .contract.variables import TRACK_STATUS
from .motion import TRUSTED, Motion, known_of

_NOT_CONVERGED = TRACK_STATUS.index("not_converged")
_MANY, _FEWEST = 0.1, 8  # share of the points that were found in the last frames, of so many at least
_NEARER = 0.5  # px from where it was looked for before, below which nothing else would be found
_REACH, _ROUNDS = 1.0, 5  # `ops.tracking_limits.REACH`, `ops.tracking.ROUNDS`
_ELSEWHERE = 0.3  # share of those that are not where the motion leads
_SEARCHES, _YIELD = 3, 0.25  # at most; share of the points searched for that is found, below which no other follows


class SecondLook:
    """Looks where the points of a frame may be that were found in one of the last frames and are not in this one.

    A frame finds a point within a pixel, in x and y, of the whole pixel nearest to where it is expected: within 0.5 px
    for sure, 1.5 px at best. Frames that run side by side expect points from `Stepper.lag` frames before: with a lag of
    two a speed that changes by v px a frame leaves up to 2 v. As long as many are missing, they are looked for

    1. where the motion up to the frame before leads, which is known by now: v is left;
    2. where the neighbours that were found say (a plane through their displacements);
    3. where a search finds them, of some of them at a time, and then again where the neighbours that this has found
       say;

    and from each of these on to where the look has led, up to five times: what `process` does with what it loses.

    A point that stays lost is not looked for so any more after `TRUSTED` frames: what is gone costs nothing.

    Args:
        before: after the last frame that counts.
        number: of this frame.
        prediction: (1, N, 2) px, where the points were expected.
        results: of the graph `frame`.

    Attributes:
        jolted: (1, N) points that were not found before a search had begun; none where there was none.
        elsewhere: whether many of the points that were not where the motion leads were found elsewhere.
    """

    def __init__(self, before: Motion, number: int, prediction: Array, results: Mapping[str, Array]) -> None:
        self._before, self._number, self._prediction, self._results = before, number, prediction, results
        self._wanted = before.missing < TRUSTED
        self.jolted = np.zeros_like(self._wanted)
        self.elsewhere = False

    def take(
        self, run: Callable[[Array], Mapping[str, Array]], search: Callable[[Array, Array], Array], together: int
    ) -> None:
        """Looks as often as it helps.

        Args:
            run: the graph `frame` again, with other predictions (1, N, 2), into the same results.
            search: from numbers (n,) of points, of which some may be the same, and where they are expected (1, n, 2),
                to where they are; NaN where that is not to be said.
            together: n.
        """
        self._try(self._before.expect(self._number), run)
        missing = int(self._lost().sum())
        self._go_on(run)
        self._look(self._results["by_neighbours"], run)
        left = self._lost()
        for _ in range(_SEARCHES):
            left &= self._lost()
            if not self._many() or not left.any():
                break
            self.jolted |= ~self._is_found()
            # Points come in the order of their strength, which is none of places: these lie all over.
            rows = np.flatnonzero(left[0])
            rows = rows[np.linspace(0, len(rows) - 1, together).round().astype(int)]
            left[:, rows] = False
            places = np.full_like(self._prediction, np.nan)
            places[:, rows] = search(rows, self._before.expect(self._number)[:, rows])
            self._look(places, run)
            if self._is_found()[0, rows].mean() < _YIELD:
                break
            self._look(self._results["by_neighbours"], run)
        self.elsewhere = missing - int(self._lost().sum()) > max(_ELSEWHERE * missing, _FEWEST)

    def _look(self, places: Array, run: Callable[[Array], Mapping[str, Array]]) -> None:
        self._try(places, run)
        self._go_on(run)

    def _try(self, places: Array, run: Callable[[Array], Mapping[str, Array]]) -> None:
        """Those that are lost and would be somewhere else."""
        other = self._lost() & (np.abs(places - self._prediction).max(-1) > _NEARER)
        if self._many() and other.any():
            self._prediction = np.where(other[..., None], places, self._prediction)
            self._results = run(self._prediction)

    def _go_on(self, run: Callable[[Array], Mapping[str, Array]]) -> None:
        """Those that lie further off than the look reaches, where it has led."""
        other = self._lost()
        for _ in range(_ROUNDS - 1):
            places = self._results["estimate"]
            beyond = np.abs(places - np.round(self._prediction)).max(-1) >= _REACH
            other &= beyond & (self._results["status"] == _NOT_CONVERGED)
            if not self._many() or not other.any():
                break
            self._prediction = np.where(other[..., None], places, self._prediction)
            self._results = run(self._prediction)

    def _is_found(self) -> Array:
        return known_of(self._results["points"])

    def _lost(self) -> Array:
        """(1, N) of the points that are wanted, those that are not found."""
        lost: Array = self._wanted & ~self._is_found()
        return lost

    def _many(self) -> bool:
        return int(self._lost().sum()) > max(_MANY * int(self._wanted.sum()), _FEWEST)
