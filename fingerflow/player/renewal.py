"""Templates that are prepared anew for the deformation of the skin."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future

import numpy as np

from .arrays import Array


class Renewal:
    """Templates that are to be prepared anew, in pieces by whoever has time.

    Args:
        rows: of the templates.
        start, warp: (1, rows, 2) px of the key frame, (1, rows, 2, 2) deformation.
        size: rows of a piece.
    """

    def __init__(self, rows: Array, start: Array, warp: Array, size: int) -> None:
        self.rows, self._start, self._warp, self._size = rows, start, warp, size
        self._pieces: list[Future[dict[str, Array]]] = [Future() for _ in range(0, len(rows), size)]
        self._open = deque(range(len(self._pieces)))

    def prepare_piece(self, prepared: Callable[[Array, Array], dict[str, Array]]) -> bool:
        """The next piece; False where none is left that nobody has begun."""
        try:
            number = self._open.popleft()
        except IndexError:
            return False
        part = slice(number * self._size, (number + 1) * self._size)
        try:
            self._pieces[number].set_result(prepared(self._start[:, part], self._warp[:, part]))
        except BaseException as error:
            self._pieces[number].set_exception(error)
            raise
        return True

    def templates(self, prepared: Callable[[Array, Array], dict[str, Array]]) -> dict[str, Array]:
        """Arrays (1, rows, ...) by the names of what is held, when all pieces are done: those left, by the caller."""
        while self.prepare_piece(prepared):
            pass
        done = [piece.result() for piece in self._pieces]
        return {name: np.concatenate([one[name] for one in done], axis=1) for name in done[0]}
