"""Detection of unusable frames: dark, saturated, repeated, torn, unreadable or noise."""

import numpy as np

from fingerflow.errors import FingerflowError
from fingerflow.kernels.array_types import Array, Numbers
from fingerflow.pipeline.stages.stage import Batch, Stage
from fingerflow.schema.variables import FRAME_CHECK, JUMPS, NOT_FINITE, REPEATED, UNREADABLE, USABLE
from fingerflow.tracker import frame_copies
from fingerflow.tracker.block_means import PictureCheck, block_means
from fingerflow.tracker.frame_distances import LONGEST, PixelSamples, squared_distances_before
from fingerflow.tracker.frame_jumps import jumps_and_returns

_MEANINGS = (  # of the indices into `FRAME_STATUS` from 1 on
    "frames that the recording cannot give whole",
    "frames with pixels that are NaN or infinite",
    "dark frames",
    "saturated frames",
    "frames that repeat another one",
    "frames far from those before and after, which agree (torn, shifted, of another light or another time)",
    "frames of noise, or with lines or blocks in disorder",
)
_EMPTY = 0.05  # share of the light of the empty glass from which none of its blocks differs where nothing touches


class FrameCheckStage(Stage):
    """Stage that detects unusable frames by means over blocks of pixels, and samples of them, in each view.

    An unusable frame is part of no result: its values are NaN, and results before and after it are as if it had not
    been recorded.
    """

    name = "frame_check"
    gives = FRAME_CHECK
    needs = ("views.contact",)
    reads_frames = True
    settings = ("background", "contact.appears", "views.contact", "views.topography", "recording.first_frame")

    def begin(self) -> None:
        views = self.inputs.scene.views
        self._views = [view for view in (views.contact, views.topography) if view is not None]
        self._status, self._empty = np.zeros(len(self.trial), np.uint8), np.zeros(len(self.trial), bool)
        self._before: list[PixelSamples | None] = [None] * len(self._views)  # samples of the last frames, for each view
        self._distances: list[list[Array]] = [[] for _ in self._views]
        self._keys: list[frame_copies.FrameKey] = []
        depth = self.inputs.recording.bit_depth
        self._alone = PictureCheck(*self.inputs.glass(views.contact), np.inf if depth is None else 2**depth - 1.5)

    def step(self, batch: Batch) -> None:
        indices = batch.indices
        view_blocks = []
        for k, view in enumerate(self._views):
            frames = self.inputs.counts(batch.frames, view)
            means, _, pixels = block_means(frames)
            blocks = np.nan_to_num(means, nan=0.0, posinf=0.0, neginf=0.0)
            if k == 0:
                self._status[indices] = self._alone.status(frames, blocks)
                lost = np.abs(blocks - self._alone.glass).max((1, 2))
                self._empty[indices] = lost < _EMPTY * self._alone.glass.mean()
            if frames.dtype.kind == "f":
                self._status[indices[~np.isfinite(frames).all(axis=(1, 2))]] = NOT_FINITE
            view_blocks.append(blocks)
            samples = PixelSamples.of(pixels)
            self._distances[k].append(squared_distances_before(samples, self._before[k]))
            self._before[k] = samples.last(LONGEST + 1, self._before[k])
        self._keys += map(frame_copies.frame_key, zip(*view_blocks, strict=True))

    def finish(self) -> None:
        """Set the status of each frame, and warn of unusable frames.

        Raises FingerflowError where no frame is usable.
        """
        status = self._status
        reasons = self.inputs.recording.unreadable
        status[list(reasons)] = UNREADABLE
        distances = np.concatenate([np.concatenate(batches) for batches in self._distances], axis=2)
        twice = frame_copies.copies(self._keys, status == USABLE)
        # A codec that predicts frames from others repeats a view in which little moves.
        exact = self.inputs.recording.takes_from_other_frames is None
        views = frame_copies.StaleViews()
        stale = [exact and views.update(key) for key in self._keys]
        # Free the memory: these lists are larger than the results of a frame without points.
        self._distances, self._keys, self._before = [], [], []
        if (share := twice.mean()) <= frame_copies.REPEATED_SHARE:
            status[twice] = REPEATED
        else:
            self.warnings.append(
                f"{self.inputs.recording.path}: {share:.0%} of the frames repeat another one: the "
                f"camera gave fewer frames than were stored, and rates and times of onset are coarser by as much"
            )
        status[np.array(stale) & (status == USABLE)] = REPEATED
        self.warnings += (causes := views.warnings())
        jumps = jumps_and_returns(distances, status == USABLE)
        # Skin may rush as it lands. Nothing tells then whether the picture returns to that of the first frames.
        jumps &= ~np.logical_and.accumulate(self._empty & (jumps | (status != USABLE)))
        status[jumps] = JUMPS
        self.results.put("frame_status", status)
        faults = [(text, at) for value, text in enumerate(_MEANINGS, 1) if len(at := np.flatnonzero(status == value))]
        for meaning, frames in faults:
            why = f" ({reasons[int(frames[0])]})" if status[frames[0]] == UNREADABLE else ""
            listed = _listed(frames + self.first_frame)
            self.warnings.append(f"{meaning}: {listed}{why}. No result counts them, theirs are NaN (frame_status)")
        if doubtful := self.inputs.recording.doubtful:
            numbers = np.array(sorted(doubtful)) + self.first_frame
            self.warnings.append(
                f"{self.inputs.recording.path}: the decoder reported errors at {_listed(numbers)} "
                f"({doubtful[min(doubtful)]}); their pixels may be wrong: copy the file again"
            )
        if not (status == USABLE).any() or len(status) - 1 in views.frames.values():
            counts = "; ".join(causes) or ", ".join(f"{len(frames)} {meaning}" for meaning, frames in faults)
            raise FingerflowError(
                f"{self.inputs.recording.path}: no frame can be measured: {counts}. Check the recording, and "
                f"[background] and [views.contact] in {self.inputs.scene.path}"
            )


def _listed(numbers: Numbers) -> str:
    first = ", ".join(str(number) for number in numbers[:10])
    return first if len(numbers) <= 10 else f"{first} ... ({len(numbers)} frames)"
