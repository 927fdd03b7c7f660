"""Create a text that identifies a recording, even among others of equal length and image size."""

import numpy as np

from fingerflow.recordings.digest import digest_of_bytes
from fingerflow.recordings.frames.recording import Recording


def identity_of(recording: Recording) -> str:
    """Return a text that identifies a recording: number, size and data type of the frames, and a hash of the first
    frame.

    No other frame is read, because in a video that may take as long as reading all of them.
    """
    height, width = recording.frame_shape
    first = np.ascontiguousarray(recording[0])
    return f"{len(recording)} frames of {height} x {width} {recording.dtype}, {digest_of_bytes([first.data])}"
