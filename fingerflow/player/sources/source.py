"""What a stream reads its frames from, and what is said of them where a file does not say it itself."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, Protocol

from fingerflow.engines.engine import Array


class Source(Protocol):
    """Gives frames (H, W) one after another, None at the end. Anything it raises but PlayerError is tried again."""

    live: bool  # frames come whether or not there is room for them

    def read(self) -> Array | None:
        """The next frame; None at the end."""

    def close(self) -> None:
        """Lets go of file or camera."""


OpenSource = Callable[[int], Source]  # from the number of the next frame


class Asked(NamedTuple):
    """A file or folder of frames, as the user names it.

    Attributes:
        first: number of the frame to begin with.
        shape, dtype: of a frame of a raw file, (H, W) and as NumPy has it.
    """

    path: Path
    first: int
    shape: tuple[int, int] | None
    dtype: str


class RecordedFrames:
    """Frames (N, H, W) that can be read by number."""

    live = False

    def __init__(self, frames: Array, first: int) -> None:
        self._frames = frames
        self._next = first

    def read(self) -> Array | None:
        """The next frame; None at the end."""
        if self._next >= len(self._frames):
            return None
        frame: Array = self._frames[self._next]
        self._next += 1
        return frame

    def close(self) -> None:
        """A map of a file goes with its last reader."""
