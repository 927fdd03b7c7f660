"""Objects that the threads of a stream exchange: closable queues and frame buffers."""

import threading
from collections import deque
from collections.abc import Iterable
from typing import Generic, TypeVar

import numpy as np

from fingerflow.engines.bundle import Bundle
from fingerflow.engines.engine import Array
from fingerflow.errors import PlayerError
from fingerflow.player.stream_scene import find_topography
from fingerflow.schema.scene import Scene
from fingerflow.schema.views import View, negative
from fingerflow.tracker.frame_tracker import CONTACT_VIEW, TOPOGRAPHY_VIEW, Frame

T = TypeVar("T")


class Channel(Generic[T]):
    """Bounded queue between threads; once closed, it returns the remaining items and then None.

    Args:
        newest_first: whether `get` returns the newest item first.
    """

    def __init__(self, size: int, items: Iterable[T] = (), newest_first: bool = False) -> None:
        self._items = deque(items)
        self._size = size
        self._take = self._items.pop if newest_first else self._items.popleft
        self._lock = threading.Lock()  # taken by itself: a condition takes its lock by two calls of Python
        self._changed = threading.Condition(self._lock)
        self._closed = False

    def put(self, item: T) -> bool:
        """Append an item after waiting for free space; return False, without appending, if the channel is closed."""
        with self._lock:
            while len(self._items) >= self._size and not self._closed:
                self._changed.wait()
            if not self._closed:
                self._items.append(item)
                self._changed.notify_all()
            return not self._closed

    def put_newest(self, item: T) -> T | None:
        """Append an item without waiting; if the queue is full, remove and return the oldest item, else return None."""
        with self._lock:
            left = self._items.popleft() if len(self._items) >= self._size else None
            self._items.append(item)
            self._changed.notify_all()
            return left

    def get(self, wait: bool = True) -> T | None:
        """Return the next item; None if the queue is empty and closed, or is empty and `wait` is False."""
        with self._lock:
            while wait and not self._items and not self._closed:
                self._changed.wait()
            item = self._take() if self._items else None
            self._changed.notify_all()
            return item

    def is_empty(self) -> bool:
        """Return whether the queue is empty now."""
        return not self._items

    def close(self) -> None:
        """Close the queue: no further items are accepted, and all waiting threads continue."""
        with self._lock:
            self._closed = True
            self._changed.notify_all()


class Slot(Frame):
    """Reusable buffer for one frame of a stream: contact and topography view (1, 1, H, W), frame number and times.

    Attributes:
        arrival: when the camera took the frame, for latencies: s on the axis of `time.perf_counter`.
        time: the same for intervals between frames, as `CameraClock.update` returns both.
    """

    def __init__(self, bundle: Bundle) -> None:
        shape = (1, 1, bundle.height, bundle.width)
        super().__init__({name: np.zeros(shape, bundle.dtype) for name in (CONTACT_VIEW, TOPOGRAPHY_VIEW)})
        self.arrival = self.time = 0.0

    def fill(self, frame: Array, scene: Scene, bundle: Bundle, source: str) -> None:
        """Crop both views, as the scene places them, from a camera frame into the buffer; raise PlayerError with the
        source's name if the frame is too small, or has not the bundle's pixel type and bit depth.
        """
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
        if scene.contact.appears == "bright":
            seen = self.views[CONTACT_VIEW]
            np.copyto(seen, negative(seen, bundle.bit_depth))


def _views(scene: Scene) -> dict[str, View]:
    return {CONTACT_VIEW: scene.views.contact, TOPOGRAPHY_VIEW: find_topography(scene)}
