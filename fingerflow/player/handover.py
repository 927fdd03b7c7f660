"""What threads pass on to each other."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

import numpy as np

from fingerflow.engines.engine import Array
from fingerflow.errors import PlayerError
from fingerflow.player.bundle import Bundle
from fingerflow.player.scene import StreamScene, ViewRange
from fingerflow.tracker.stream import CONTACT_VIEW, TOPOGRAPHY_VIEW, Frame

T = TypeVar("T")


class Channel(Generic[T]):
    """A bounded queue between threads that can be closed: what is in it is still given, then None.

    Args:
        newest_first: give the item that came last first.
    """

    def __init__(self, size: int, items: Iterable[T] = (), newest_first: bool = False) -> None:
        self._items = deque(items)
        self._size = size
        self._take = self._items.pop if newest_first else self._items.popleft
        self._changed = threading.Condition()
        self._closed = False

    def put(self, item: T) -> bool:
        """Waits for room; False, and the item is not taken, where the channel is closed."""
        with self._changed:
            while len(self._items) >= self._size and not self._closed:
                self._changed.wait()
            if not self._closed:
                self._items.append(item)
                self._changed.notify_all()
            return not self._closed

    def put_newest(self, item: T) -> T | None:
        """Never waits: where there is no room, the oldest item leaves and is returned."""
        with self._changed:
            left = self._items.popleft() if len(self._items) >= self._size else None
            self._items.append(item)
            self._changed.notify_all()
            return left

    def get(self, wait: bool = True) -> T | None:
        """The next item; None where there is none and the channel is closed or is not to be waited for."""
        with self._changed:
            while wait and not self._items and not self._closed:
                self._changed.wait()
            item = self._take() if self._items else None
            self._changed.notify_all()
            return item

    def is_empty(self) -> bool:
        """Whether there is no item now."""
        return not self._items

    def close(self) -> None:
        """Takes no item any more, and ends all waiting."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()


class InOrder(Generic[T]):
    """Ends in the order in which they began what several threads do side by side.

    A thread that is done before its turn leaves its piece to the one that has the turn.

    Args:
        end: called with one piece after the other, by any of the threads; False stops.
        most: pieces that have begun and not ended, at most.

    Attributes:
        begun: pieces that have begun.
    """

    def __init__(self, end: Callable[[T], bool], most: int) -> None:
        self._end, self._most = end, most
        self._done: dict[int, T] = {}
        self.begun = self._ended = 0
        self._ending = self._stopped = False
        self._changed = threading.Condition()

    def wait_for_room(self) -> bool:
        """Until another may begin; False after a stop."""
        with self._changed:
            self._changed.wait_for(lambda: self._stopped or self.begun - self._ended < self._most)
            return not self._stopped

    def wait_for_all(self) -> bool:
        """Until all that have begun have ended; False after a stop."""
        with self._changed:
            self._changed.wait_for(lambda: self._stopped or self._ended == self.begun)
            return not self._stopped

    def begin(self) -> int:
        """The number of a piece that begins, by one thread at a time."""
        self.begun += 1
        return self.begun - 1

    def done(self, number: int, piece: T) -> None:
        """Ends a piece, and those that wait for it, unless one before it is missing."""
        with self._changed:
            self._done[number] = piece
            if self._ending:
                return
            self._ending = True
        while True:
            with self._changed:
                if self._ended not in self._done:
                    self._ending = False
                    return
                piece = self._done.pop(self._ended)
            going = self._end(piece)
            with self._changed:
                self._ended += 1
                self._stopped |= not going
                self._changed.notify_all()

    def stop(self) -> None:
        """Nothing begins any more; what has begun before the first that does not come still ends."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()


class Slot(Frame):
    """Room for one frame: both views (1, 1, H, W), its number and when it arrived."""

    def __init__(self, bundle: Bundle) -> None:
        shape = (1, 1, bundle.height, bundle.width)
        super().__init__({name: np.zeros(shape, bundle.dtype) for name in (CONTACT_VIEW, TOPOGRAPHY_VIEW)})
        self.arrival = 0.0

    def fill(self, frame: Array, scene: StreamScene, bundle: Bundle, source: str) -> None:
        """Copies the views out of a frame; raises PlayerError where its size or depth is another one."""
        needed = [max(ends) for ends in zip(*((v.rows[1], v.columns[1]) for v in _views(scene).values()), strict=True)]
        if frame.ndim != 2 or frame.shape[0] < needed[0] or frame.shape[1] < needed[1]:
            raise PlayerError(
                f"{source}: a frame is {frame.shape}, the views of the scene need (H, W) of at least {tuple(needed)}; "
                "correct [views] of the scene or the size that the camera is set to"
            )
        if frame.dtype != bundle.dtype:
            raise PlayerError(
                f"{source}: a frame is {frame.dtype}, the bundle takes {bundle.dtype} (bit_depth {bundle.bit_depth}); "
                "set the camera to that depth or export a bundle with the camera's"
            )
        for name, view in _views(scene).items():
            np.copyto(self.views[name][0, 0], view.crop(frame))
            if 8 < bundle.bit_depth < 16 and self.views[name].max() >> bundle.bit_depth:
                raise PlayerError(
                    f"{source}: a frame holds {self.views[name].max()}, more than the {bundle.bit_depth} bits of the "
                    "bundle; export one with the camera's bit_depth"
                )


def _views(scene: StreamScene) -> dict[str, ViewRange]:
    return {CONTACT_VIEW: scene.contact, TOPOGRAPHY_VIEW: scene.topography}
