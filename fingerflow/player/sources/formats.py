"""Source for recordings in the formats of `fingerflow.recordings` that need only NumPy or tifffile."""

from __future__ import annotations

import logging

from fingerflow.engines.engine import Array
from fingerflow.errors import FingerflowError, PlayerError
from fingerflow.player.sources.source import Asked, Source
from fingerflow.recordings.frames.opening import open_recording
from fingerflow.recordings.frames.recording import Recording

READS = "a recording (.cine, .mraw or .npy; .tif where tifffile is installed)"
_SUFFIXES = (".cih", ".cihx", ".cine", ".mraw", ".npy", ".tif", ".tiff")
log = logging.getLogger("fingerflow.player")


def reads(asked: Asked) -> bool:
    """Return whether the name ends in one of the suffixes of these formats."""
    return asked.path.is_file() and asked.path.suffix.lower() in _SUFFIXES


def open_frames(asked: Asked) -> Source:
    """Return the frames; raise PlayerError with the reader's message, or with the name of a missing library."""
    try:
        recording = open_recording(asked.path)
    except FingerflowError as error:
        raise PlayerError(str(error)) from None
    except ImportError as error:
        raise PlayerError(
            f"{asked.path}: its format needs the library {error.name}: `pip install {error.name}`, or give frames as "
            ".npy"
        ) from None
    for sentence in recording.warnings:
        log.warning("%s: %s", asked.path, sentence)
    return Recorded(recording, asked.first)


class Recorded:
    """Frames of such a recording from number `first` on."""

    live = False

    def __init__(self, recording: Recording, first: int) -> None:
        self._recording, self._next = recording, first

    def read(self) -> Array | None:
        """Return the next frame; None at the end. A damaged frame is black, so that it is not usable, and is logged.

        Raises PlayerError for a frame of another size than the first.
        """
        if self._next >= len(self._recording):
            return None
        try:
            frame: Array = self._recording[self._next]
        except FingerflowError as error:  # a second attempt would fail too
            raise PlayerError(str(error)) from None
        damage = self._recording.unreadable.get(self._next)
        if damage:
            log.warning("%s: frame %d %s", self._recording.path, self._next, damage)
        self._next += 1
        return frame

    def close(self) -> None:
        """Close the file."""
        self._recording.close()
