"""Source of frames from recordings, in those formats of `fingerflow.recordings` that need only NumPy or tifffile."""

from __future__ import annotations

import logging
from collections.abc import Iterator

from fingerflow.engines.engine import Array
from fingerflow.errors import PlayerError
from fingerflow.player.sources.source import RecordedFrames, Source, SourceRequest
from fingerflow.recordings.frames.open_recording import open_recording
from fingerflow.recordings.frames.recording import Recording

READS = "a recording (.cine, .mraw or .npy; .tif where tifffile is installed)"
_SUFFIXES = (".cih", ".cihx", ".cine", ".mraw", ".npy", ".tif", ".tiff")
log = logging.getLogger("fingerflow.player")


def reads(asked: SourceRequest) -> bool:
    """Return whether the requested file has a suffix of one of the supported recording formats."""
    return asked.path.is_file() and asked.path.suffix.lower() in _SUFFIXES


def open_frames(asked: SourceRequest) -> Source:
    """Open a recording as a source of frames; raise FingerflowError for a damaged file or a missing library."""
    try:
        recording = open_recording(asked.path)
    except ImportError as error:
        raise PlayerError(
            f"{asked.path}: its format needs the library {error.name}: `pip install {error.name}`, or give frames as "
            ".npy"
        ) from None
    for sentence in recording.warnings:
        log.warning("%s: %s", asked.path, sentence)
    return RecordedFrames(_frames(recording, asked.first), recording.close)


def _frames(recording: Recording, first: int) -> Iterator[Array]:
    """Yield the frames of a recording from number `first` on.

    A damaged frame is black, so that it is not usable, and is logged. Raises FingerflowError for a frame of another
    size than the first.
    """
    for number in range(first, len(recording)):
        frame = recording[number]
        if damage := recording.unreadable.get(number):
            log.warning("%s: frame %d %s", recording.path, number, damage)
        yield frame
