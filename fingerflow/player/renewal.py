"""Templates that are prepared anew for the deformation of the skin."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future

import numpy as np

from .arrays import Array
from .contract.pace import MOST_FRAMES, frames_to_next_look


class Pace:
    """After how many frames templates are looked at again: fewer where the skin deforms fast.

    As in `process`, by `contract.pace`.

    Args:
        window_px: side of a window.

    Attributes:
        frames: from the last look to the next.
    """

    def __init__(self, window_px: int) -> None:
        self._half = window_px // 2
        self._before: tuple[int, int, Array] | None = None  # key frame, frame and deformation of the last look
        self.frames = MOST_FRAMES

    def see(self, key: int, index: int, warp: Array) -> None:
        """Deformations (1, N, 2, 2) since a key frame, by their number, in the frame `index`; NaN where unknown."""
        before, self._before = self._before, (key, index, warp.copy())
        self.frames = MOST_FRAMES
        if before is None or before[0] != key:
            return
        change = np.sqrt(np.square(warp - before[2]).sum((-2, -1)))
        change = change[np.isfinite(change)]
        if len(change):
            fastest = self._half * float(np.quantile(change, 0.95)) / (index - before[1])
            self.frames = frames_to_next_look(fastest)


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
