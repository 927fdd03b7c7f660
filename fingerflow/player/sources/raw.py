"""Files of pixels alone, frame after frame; the user says how large a frame is."""

from __future__ import annotations

import math

import numpy as np

from fingerflow.errors import PlayerError
from fingerflow.player.sources.source import Asked, RecordedFrames, Source

READS = "a raw file"


def reads(asked: Asked) -> bool:
    """Whatever is given a shape; files that have one are taken by `formats` before."""
    named = asked.path.suffix in (".raw", ".bin")
    return asked.path.is_file() and (named or asked.shape is not None)


def open_frames(asked: Asked) -> Source:
    """Whole frames, mapped; raises PlayerError where their shape is not said or there is none."""
    if asked.shape is None:
        raise PlayerError(f"{asked.path}: a raw file needs --shape HEIGHT WIDTH and --dtype of its frames")
    pixels = np.memmap(asked.path, np.dtype(asked.dtype), "r")
    frames = pixels[: len(pixels) - len(pixels) % math.prod(asked.shape)].reshape(-1, *asked.shape)
    if not len(frames):
        raise PlayerError(
            f"{asked.path}: its array is {frames.shape}; frames are (N, H, W) and at least one is needed: it has "
            f"{len(pixels)} pixels, fewer than a frame of {asked.shape[0]} x {asked.shape[1]}: correct it"
        )
    return RecordedFrames(frames, asked.first)
