"""Define the interface of frame sources."""

import math
import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Protocol

from fingerflow.engines.engine import Array
from fingerflow.errors import first_line
from fingerflow.player.logged_warnings import log


class Source(Protocol):
    """Interface of a source of frames (H, W).

    After any error other than FingerflowError it is opened again.
    """

    live: bool  # True if frames arrive at the pace of a camera, whether or not a buffer is free
    stamp: float  # s, time of the last frame by the clock of the camera or in the recording; NaN if there is none

    def read(self) -> Array | None:
        """Return the next frame (H, W); None after the last frame."""

    def close(self) -> None:
        """Close the file or camera."""


OpenSource = Callable[[int], Source]  # function from the number of the next frame to the opened source


class RecordedFrames:
    """Source of frames (H, W) that an iterator reads from a file; `close` closes the file."""

    live = False

    def __init__(
        self, frames: Iterator[Array], close: Callable[[], None] = lambda: None, times: Iterable[float] = ()
    ) -> None:
        self._frames, self.close, self._times, self.stamp = frames, close, iter(times), math.nan

    def read(self) -> Array | None:
        """Return the next frame (H, W); None after the last frame."""
        self.stamp = float(next(self._times, math.nan))
        return next(self._frames, None)


def close_within(seconds: float, source: Source) -> None:
    """Close a source of frames, waiting at most `seconds`; log a warning if closing fails or takes longer."""

    def close() -> None:
        try:
            source.close()
        except BaseException as error:
            log.warning("closing the source: %s", first_line(error))

    closing = threading.Thread(target=close, name="close", daemon=True)
    closing.start()
    closing.join(seconds)
    if closing.is_alive():
        log.warning("closing the source takes more than %.0f s: it is left behind", seconds)
