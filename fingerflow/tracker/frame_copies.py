"""Detection of frames that repeat an earlier frame exactly, which camera noise makes impossible for two exposures."""

import hashlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

REPEATED_SHARE = 0.2  # share of repeated frames above which repetitions are normal for the camera and no fault
_ALIKE = 1.25  # ratio of squared distances below which both of two equal frames fit their neighbours equally well


def frame_key(blocks: Sequence[NDArray[Any]]) -> bytes:
    """Return a hash of a frame, computed from the block means of all its views; equal frames have equal hashes."""
    result = hashlib.blake2b(digest_size=16)
    for block in blocks:
        result.update(block.data)
    return result.digest()


def copies(keys: Sequence[bytes], distances: NDArray[np.float32], usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask (F,) of frames that are exact copies of another frame, found by equal hashes; where equal frames
    lie apart, their distances from the frames around them tell which is the copy.

    Of frames that repeat the one before, the first counts. Frames that equal others further away belong to one of both
    places: those that are further from the frames around them are the copies, and both where neither fits better.

    Args:
        keys: of all frames (`frame_key`).
        distances: (F, LONGEST + 1, rows) of `squared_distances_before`.
        usable: (F,) False for frames that are not compared.
    """
    frames = len(keys)
    first: dict[bytes, int] = {}
    original = np.array([first.setdefault(keys[k], k) if usable[k] else k for k in range(frames)], np.intp)
    repeated = np.zeros(frames, dtype=bool)
    repeated[1:] = usable[1:] & (original[1:] == original[:-1])
    separate = iter(((original < np.arange(frames)) & ~repeated).nonzero()[0].tolist())
    end = 0
    for frame in separate:
        if frame < end:
            continue
        end = frame + 1
        while end < frames and not repeated[end] and original[end] == original[frame] + end - frame < frame:
            end += 1
        here, there = slice(frame, end), slice(int(original[frame]), int(original[frame]) + end - frame)
        off, off_there = _distance_around(distances, here), _distance_around(distances, there)
        repeated[here] |= off * _ALIKE >= off_there
        repeated[there] |= off_there * _ALIKE >= off
    return repeated


def _distance_around(distances: NDArray[np.float32], frames: slice) -> float:
    """Return the larger of two squared image distances of a run of consecutive frames: that of its first frame from the
    frame before the run, and that of its last frame from the frame after it.
    """
    return float(np.nanmax(distances[[k for k in (frames.start, frames.stop) if 0 < k < len(distances)], 0], initial=1))
