"""Detection of unusable frames: dark, saturated, repeated, torn, unreadable or noise."""

import numpy as np

from fingerflow.errors import FingerflowError
from fingerflow.kernels.array_types import Numbers
from fingerflow.pipeline.stages.stage import Batch, Stage
from fingerflow.schema.variables import FRAME_CHECK, UNREADABLE, USABLE
from fingerflow.tracker.block_means import PictureCheck
from fingerflow.tracker.frame_copies import REPEATED_SHARE
from fingerflow.tracker.recorded.frame_quality import RecordedFrameCheck

_MEANINGS = (  # of the indices into `FRAME_STATUS` from 1 on
    "frames that the recording cannot give whole",
    "frames with pixels that are NaN or infinite",
    "dark frames",
    "saturated frames",
    "frames that repeat another one",
    "frames far from those before and after, which agree (torn, shifted, of another light or another time)",
    "frames of noise, or with lines or blocks in disorder",
)


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
        views, recording = self.inputs.scene.views, self.inputs.recording
        self._views = [view for view in (views.contact, views.topography) if view is not None]
        self._check = RecordedFrameCheck(PictureCheck(*self.inputs.glass(views.contact), recording.bit_depth))

    def step(self, batch: Batch) -> None:
        self._check.add_frames([self.inputs.counts(batch.frames, view) for view in self._views])

    def finish(self) -> None:
        """Set the status of each frame, and warn of unusable frames.

        Raises FingerflowError where no frame is usable.
        """
        reasons, exact = self.inputs.recording.unreadable, self.inputs.recording.takes_from_other_frames is None
        status, repeated, views = self._check.finish(reasons, exact)
        del self._check  # what it holds is larger than the results of a frame without points
        if repeated > REPEATED_SHARE:
            self.warnings.append(
                f"{self.inputs.recording.path}: {repeated:.0%} of the frames repeat another one: the "
                f"camera gave fewer frames than were stored, and rates and times of onset are coarser by as much"
            )
        self.warnings += (causes := views.warnings())
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
