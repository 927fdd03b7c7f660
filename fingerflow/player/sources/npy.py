"""NumPy's own files."""

from __future__ import annotations

import numpy as np

from ..contract.claimed_sizes import MOST_NPY_HEADER, npy_header_bytes
from ..errors import PlayerError
from .source import Asked, Recording, Source

READS = "a .npy file"


def reads(asked: Asked) -> bool:
    """By the name's end."""
    return asked.path.is_file() and asked.path.suffix == ".npy"


def open_frames(asked: Asked) -> Source:
    """An array (N, H, W) or (H, W), mapped; raises PlayerError for another."""
    with open(asked.path, "rb") as file:
        length = npy_header_bytes(file.read(12))
    if length > MOST_NPY_HEADER:
        raise PlayerError(f"{asked.path}: its header should have {length} bytes, and no array has; save it anew")
    frames = np.load(asked.path, mmap_mode="r")
    frames = frames[None] if frames.ndim == 2 else frames
    if frames.ndim != 3 or not len(frames):
        raise PlayerError(f"{asked.path}: its array is {frames.shape}; frames are (N, H, W) and at least one is needed")
    return Recording(frames, asked.first)
