"""Frame quality in a recording: detection of invalid images by their own pixels and by those of all other frames."""

from collections.abc import Iterable, Sequence

import numpy as np

from fingerflow.kernels.array_types import Array
from fingerflow.schema.variables import JUMPS, REPEATED, UNREADABLE, USABLE
from fingerflow.tracker import frame_copies
from fingerflow.tracker.block_means import PictureCheck
from fingerflow.tracker.frame_distances import LONGEST, PixelSamples, squared_distances_before
from fingerflow.tracker.frame_jumps import jumps_and_returns

_EMPTY = 0.05  # share of the light of the empty glass from which none of its blocks differs where nothing touches


class RecordedFrameCheck:
    """Detection of invalid frames of a recording; `FrameCheck` is that of a stream, which does not know later frames.

    Args:
        alone: judges frames by their own pixels.
    """

    def __init__(self, alone: PictureCheck) -> None:
        self._alone = alone
        self._status: list[Array] = []
        self._empty: list[Array] = []
        self._keys: list[frame_copies.FrameKey] = []
        self._samples: dict[int, PixelSamples] = {}  # of the last frames, for each view
        self._distances: dict[int, list[Array]] = {}  # (n, gaps, rows) of each view

    def add_frames(self, views: Sequence[Array]) -> None:
        """Judge the next n frames by themselves, and compare them with those before, from their views (n, H, W), the
        contact view first.
        """
        frames_alone = self._alone.inspect(views)
        lost = np.abs(frames_alone.blocks - self._alone.glass).max((1, 2))
        self._status.append(frames_alone.status)
        self._empty.append(lost < _EMPTY * self._alone.glass.mean())
        self._keys += frames_alone.keys
        for view, pixels in enumerate(frames_alone.pixels):
            samples, before = PixelSamples.of(pixels), self._samples.get(view)
            self._distances.setdefault(view, []).append(squared_distances_before(samples, before))
            self._samples[view] = samples.after(before).rows(slice(-LONGEST - 1, None))

    def finish(self, unreadable: Iterable[int], exact: bool) -> tuple[Array, float, frame_copies.StaleViews]:
        """Return the status (F,) of all frames, of which those with the numbers `unreadable` have no picture; the share
        of the frames that repeat another one; and the frames in which a view repeats its picture.

        `exact` is False for a codec that predicts frames from others, and so repeats a view in which little moves. More
        than a fifth of repeated frames are the camera's, and count.
        """
        status = np.concatenate(self._status)
        status[list(unreadable)] = UNREADABLE
        twice = frame_copies.copies(self._keys, status == USABLE)
        views = frame_copies.StaleViews()
        stale = np.array([exact and views.update(key) for key in self._keys])
        if twice.mean() <= frame_copies.REPEATED_SHARE:
            status[twice] = REPEATED
        status[stale & (status == USABLE)] = REPEATED
        distances = np.concatenate([np.concatenate(batches) for batches in self._distances.values()], axis=2)
        jumps = jumps_and_returns(distances, status == USABLE)
        # Skin may rush as it lands. Nothing tells then whether the picture returns to that of the first frames.
        jumps &= ~np.logical_and.accumulate(np.concatenate(self._empty) & (jumps | (status != USABLE)))
        status[jumps] = JUMPS
        return status, twice.mean(), views
