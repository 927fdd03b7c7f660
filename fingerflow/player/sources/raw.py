"""Source of frames from raw files: pixels without a header, frame after frame; the user gives the frame size."""

from __future__ import annotations

import math

import numpy as np

from fingerflow.errors import PlayerError
from fingerflow.player.sources.source import RecordedFrames, Source, SourceRequest

READS = "a raw file"


def reads(asked: SourceRequest) -> bool:
    """Return whether the request is for a .raw or .bin file, or for any file with a given frame shape.

    Files of known formats are read by `formats`, which is asked before.
    """
    named = asked.path.suffix in (".raw", ".bin")
    return asked.path.is_file() and (named or asked.shape is not None)


def open_frames(asked: SourceRequest) -> Source:
    """Open a raw file as a memory-mapped source of the complete frames in the file.

    Raise PlayerError without a given shape or without a complete frame.
    """
    if asked.shape is None:
        raise PlayerError(f"{asked.path}: a raw file needs --shape HEIGHT WIDTH and --dtype of its frames")
    pixels = np.memmap(asked.path, np.dtype(asked.dtype), "r")
    frames = pixels[: len(pixels) - len(pixels) % math.prod(asked.shape)].reshape(-1, *asked.shape)
    if not len(frames):
        raise PlayerError(
            f"{asked.path}: its array is {frames.shape}; frames are (N, H, W) and at least one is needed: it has "
            f"{len(pixels)} pixels, fewer than a frame of {asked.shape[0]} x {asked.shape[1]}: correct it"
        )
    return RecordedFrames(iter(frames[asked.first :]))
