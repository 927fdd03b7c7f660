"""Detection of frames, or of one of their views, that repeat an earlier picture exactly, which camera noise makes
impossible for two exposures.
"""

import hashlib
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

REPEATED_SHARE = 0.2  # share of repeated frames above which repetitions are normal for the camera and no fault
_VIEWS = ("contact", "topography")  # in the order of a key

FrameKey = tuple[bytes, ...]


def frame_key(blocks: Sequence[NDArray[Any]]) -> FrameKey:
    """Return a hash of each view of a frame, computed from its block means: equal pictures have equal hashes. It is
    empty for a view of one grey level, such as one without light.
    """
    return tuple(hashlib.blake2b(block.data, digest_size=16).digest() if np.ptp(block) else b"" for block in blocks)


class StaleViews:
    """Detector of frozen views: frames in which one view repeats its previous picture, and the other view does not."""

    def __init__(self) -> None:
        self._before: FrameKey = ()
        self._compared = -1  # number of frames that were compared with the one before
        self._in_a_row = 0
        self.frames = Counter[str]()  # in which each view was stale

    def update(self, key: FrameKey) -> bool:
        """Add the next frame by its key; return whether a view is frozen in it and in the three before, and was not
        frozen in all frames so far. A frame without light counts as none.
        """
        if not any(key):
            return False
        views = zip(_VIEWS, key, self._before, strict=False)
        stale = {view for view, now, before in views if now == before != b"" and key != self._before}
        self.frames.update(stale)
        self._before, self._compared = key, self._compared + 1
        self._in_a_row = (self._in_a_row + 1) * any(self.frames[view] < self._compared for view in stale)
        return self._in_a_row > 3

    def warnings(self) -> list[str]:
        """Return a warning for each view that was stale; safe in any thread."""
        return [
            f"the {view} view repeats its picture while the other view goes on, in {frames} frames: its camera stands "
            f"still or is slower, and points or contact are of an earlier moment. Check its rate, trigger and cable"
            f"{', or leave it out to measure contact alone' * (view == 'topography')}"
            for view, frames in [*self.frames.items()]
        ]


def copies(keys: Sequence[FrameKey], usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask (F,) of frames that equal another one. Of frames that repeat the one before, the first counts; of
    frames that lie apart none does, as only one place is theirs.

    Args:
        keys: of all frames (`frame_key`).
        usable: (F,) False for frames that are not compared.
    """
    repeated, latest = np.zeros(len(keys), dtype=bool), dict[FrameKey, int]()
    for frame in usable.nonzero()[0].tolist():
        before = latest.get(keys[frame], frame)
        repeated[frame] |= before != frame
        repeated[before] |= before < frame - 1
        latest[keys[frame]] = frame
    return repeated
