"""Objects that the threads of a stream exchange: closable queues and frame buffers."""

from collections import deque
from collections.abc import Iterable
from queue import Empty, SimpleQueue
from typing import Generic, TypeVar

import numpy as np

from fingerflow.engines.bundle import Bundle
from fingerflow.engines.engine import Array
from fingerflow.errors import PlayerError
from fingerflow.player.stream_scene import find_topography
from fingerflow.schema.scene import Scene
from fingerflow.schema.views import negative
from fingerflow.tracker.frame_tracker import CONTACT_VIEW, TOPOGRAPHY_VIEW, Frame

T = TypeVar("T")


class Channel(Generic[T]):
    """Bounded queue between threads; once closed, it returns the remaining items and then None.

    Args:
        newest_first: whether `get` returns the newest item first.
    """

    def __init__(self, size: int, items: Iterable[T] = (), newest_first: bool = False) -> None:
        self._items = deque(items)
        self._take = self._items.pop if newest_first else self._items.popleft
        # Tokens: True for each item, or for each free place; False once the channel is closed. `SimpleQueue` waits
        # without calls of Python, which `threading.Condition` does not.
        self._filled, self._free = SimpleQueue[bool](), SimpleQueue[bool]()
        self._closed = False
        for place in range(size):
            (self._filled if place < len(self._items) else self._free).put(True)

    def put(self, item: T) -> bool:
        """Append an item after waiting for free space; return False, without appending, if the channel is closed."""
        if self._closed or not self._free.get():
            self._free.put(False)
            return False
        self._items.append(item)
        self._filled.put(True)
        return True

    def put_newest(self, item: T) -> T | None:
        """Append an item without waiting, and return the oldest one if the queue was full, else None; return the item
        itself if the channel is closed. Only one thread may append.
        """
        if self._closed:
            return item
        left = None
        try:
            self._free.get(block=False)
        except Empty:
            try:
                self._filled.get(block=False)
                left = self._items.popleft()
            except Empty:  # another thread is taking the oldest item
                self._free.get()
        self._items.append(item)
        self._filled.put(True)
        return left

    def get(self, wait: bool = True) -> T | None:
        """Return the next item; None if the queue is empty and closed or, without `wait`, if it is empty."""
        try:
            filled = self._filled.get(wait)
        except Empty:
            return None
        if not filled:
            self._filled.put(False)
            return None
        item = self._take()
        self._free.put(True)
        return item

    def __len__(self) -> int:
        """Return the number of items in the queue now."""
        return len(self._items)

    def close(self) -> None:
        """Close the queue: no further items are accepted, and all waiting threads continue."""
        self._closed = True
        self._filled.put(False)
        self._free.put(False)


class Slot(Frame):
    """Reusable buffer for one frame of a stream: contact and topography view (1, 1, H, W), frame number and times.

    Attributes:
        arrival: when the camera took the frame, for latencies: s on the axis of `time.perf_counter`.
        time: the same for intervals between frames, as `CameraClock.update` returns both.
    """

    def __init__(self, bundle: Bundle, scene: Scene) -> None:
        shape = (1, 1, bundle.height, bundle.width)
        self._placed = {CONTACT_VIEW: scene.views.contact, TOPOGRAPHY_VIEW: find_topography(scene)}
        rows, columns = zip(*((view.rows, view.columns) for view in self._placed.values()), strict=True)
        self._needed = max(end for _, end in rows), max(end for _, end in columns)
        self._bright = scene.contact.appears == "bright"
        super().__init__({name: np.zeros(shape, bundle.dtype) for name in (CONTACT_VIEW, TOPOGRAPHY_VIEW)})
        self.arrival = self.time = 0.0

    def fill(self, frame: Array, bundle: Bundle, source: str) -> None:
        """Crop both views, as the scene places them, from a camera frame into the buffer; raise PlayerError with the
        source's name if the frame is too small, or has not the bundle's pixel type and bit depth.
        """
        needed = self._needed
        if frame.ndim != 2:
            raise PlayerError(
                f"{source}: a frame is {frame.shape}, not (H, W): of a colour camera; set it to grey (Mono8, Mono16)"
            )
        if frame.shape[0] < needed[0] or frame.shape[1] < needed[1]:
            raise PlayerError(
                f"{source}: a frame is {frame.shape}, the views of the scene need (H, W) of at least {needed}; "
                "correct [views] of the scene or the size that the camera is set to"
            )
        if frame.dtype != bundle.dtype:
            raise PlayerError(
                f"{source}: a frame is {frame.dtype}, the bundle takes {bundle.dtype} (bit_depth {bundle.bit_depth}); "
                "set the camera to that depth or export a bundle with the camera's"
            )
        for name, view in self._placed.items():
            self.views[name][...] = frame[slice(*view.rows), slice(*view.columns)]
            if 8 < bundle.bit_depth < 16 and self.views[name].max() >> bundle.bit_depth:
                raise PlayerError(
                    f"{source}: a frame holds {self.views[name].max()}, more than the {bundle.bit_depth} bits of the "
                    "bundle; export one with the camera's bit_depth"
                )
        if self._bright:
            self.views[CONTACT_VIEW][...] = negative(self.views[CONTACT_VIEW], 2**bundle.bit_depth - 1)
