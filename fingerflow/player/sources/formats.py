"""Recordings in the formats that the package's own readers know and that need NumPy alone, or tifffile."""

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
    """By the name's end."""
    return asked.path.is_file() and asked.path.suffix.lower() in _SUFFIXES


def open_frames(asked: Asked) -> Source:
    """Raises PlayerError with what the reader says, or with the library that it lacks."""
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
    """Frames of such a recording from a number on."""

    live = False

    def __init__(self, recording: Recording, first: int) -> None:
        self._recording, self._next = recording, first

    def read(self) -> Array | None:
        """The next frame; None at the end. A damaged one is dark, so that it counts in no result, and is named.

        Raises PlayerError for one that is of another size than the first.
        """
        if self._next >= len(self._recording):
            return None
        try:
            frame: Array = self._recording[self._next]
        except FingerflowError as error:  # nothing that a second try would mend
            raise PlayerError(str(error)) from None
        damage = self._recording.unreadable.get(self._next)
        if damage:
            log.warning("%s: frame %d %s", self._recording.path, self._next, damage)
        self._next += 1
        return frame

    def close(self) -> None:
        """Lets go of the file."""
        self._recording.close()
