"""What tells one recording from another of the same length and size."""

import numpy as np

from fingerflow.recordings.digest import digest_of_bytes
from fingerflow.recordings.frames.recording import Recording


def identity_of(recording: Recording) -> str:
    """Number, size and type of the frames and a digest of the first one's pixels: the camera's noise is never the same
    again. No other frame is read, which in a video may take as long as all of them.
    """
    height, width = recording.frame_shape
    first = np.ascontiguousarray(recording[0])
    return f"{len(recording)} frames of {height} x {width} {recording.dtype}, {digest_of_bytes([first.data])}"
