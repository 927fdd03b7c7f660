"""Which frames are pictures of the trial, before anything is measured in them."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fingerflow.errors import FingerflowError
from fingerflow.ops.frame_returns import LONGEST, band_distances, jumps_and_returns, repeats
from fingerflow.player.contract.variables import FRAME_CHECK, FRAME_STATUS
from fingerflow.stages.stage import Batch, Stage, Trial
from fingerflow.views import View

_STEP = 4  # px between those that are looked at
_DARK = 0.1  # of the empty glass's light: a contact leaves half
_SATURATED = 0.5  # of the pixels, at the highest level that there is
_REPEATED_SHARE = 0.2  # of the frames, beyond which they are the recording's own and not the camera's fault
_USABLE, _UNREADABLE, _NOT_FINITE, _DARK_FRAME, _SATURATED_FRAME, _REPEATED, _RETURNS = range(len(FRAME_STATUS))
_SAID = {
    _UNREADABLE: "the recording cannot give whole",
    _NOT_FINITE: "have pixels that are NaN or infinite",
    _DARK_FRAME: "are dark",
    _SATURATED_FRAME: "are saturated",
    _REPEATED: "repeat the frame before",
    _RETURNS: "jump away from the frames before and after, which agree: torn, shifted, or of another light or time",
}


class FrameCheckStage(Stage):
    """Finds frames that cannot be by their own statistics, of every fourth pixel of every fourth row of the views.

    Such a frame is no part of any result: what depends on it is NaN, and what stands before and after it is as if it
    had not been recorded.

    Attributes:
        usable: (frames,) bool; once it has finished.
    """

    name = "frame_check"
    gives = FRAME_CHECK
    needs = ("views.contact",)
    reads_frames = True

    usable: NDArray[np.bool_]

    def __init__(self, trial: Trial) -> None:
        super().__init__(trial)
        views = self.inputs.scene.views
        self._views = [view for view in (views.contact, views.topography) if view is not None]
        self._status = np.zeros(len(trial), np.uint8)
        self._before: list[Tensor] = []
        self._distances: list[list[NDArray[np.float32]]] = [[] for _ in self._views]
        self._light, self._saturated = np.full((2, len(trial)), np.nan)
        self._sum = 0.0

    def begin(self) -> None:
        contact = self._views[0]
        glass, dark = self.inputs.reference(contact), self.inputs.dark(contact)
        self._black = 0.0 if dark is None else float(_sampled(dark).mean())
        self._glass = float(_sampled(glass).mean()) - self._black
        depth = self.inputs.recording.bit_depth
        self._top = np.inf if depth is None else float(2**depth - 1)
        self._glass_saturated = float((_sampled(glass) >= self._top).float().mean())

    def step(self, batch: Batch) -> None:
        assert batch.frames is not None
        indices = batch.indices
        for k, view in enumerate(self._views):
            frames = self._look(batch.frames, view)
            if batch.frames.dtype.kind == "f":
                whole = torch.from_numpy(np.isfinite(view.crop(batch.frames)).all(axis=(1, 2)))
                self._status[indices[~whole.numpy()]] = _NOT_FINITE
                frames = frames.nan_to_num(0.0, 0.0, 0.0)
            if k == 0:
                self._light[indices] = frames.mean((1, 2, 3)).cpu() - self._black
                self._saturated[indices] = (frames >= self._top).float().mean((1, 2, 3)).cpu()
            if len(self._before) <= k:
                self._before.append(frames[:0])
            self._distances[k].append(band_distances(frames, self._before[k]).cpu().numpy())
            self._before[k] = torch.cat([self._before[k], frames])[-LONGEST - 1 :].clone()

    def finish(self) -> None:
        """Names what was found in warnings. Raises FingerflowError where no frame is usable."""
        status = self._status
        reasons = getattr(self.inputs.recording, "unreadable", {})
        status[list(reasons)] = _UNREADABLE
        sound = status == _USABLE
        status[sound & (self._light < _DARK * self._glass)] = _DARK_FRAME
        if self._glass_saturated < _SATURATED:
            status[sound & (self._saturated > _SATURATED)] = _SATURATED_FRAME
        distances = np.concatenate([np.concatenate(one) for one in self._distances], axis=2)
        twice = repeats(distances) & (status == _USABLE)
        share = float(twice.mean())
        if share <= _REPEATED_SHARE:
            status[twice] = _REPEATED
        else:
            self.inputs.warnings.append(
                f"{self.inputs.recording.path}: {share:.0%} of the frames repeat the one before, pixel by pixel: the "
                f"camera gave fewer frames than were stored, and rates and times of onset are coarser by as much"
            )
        mean = float(np.nanmedian(self._light)) + self._black
        status[jumps_and_returns(distances, mean, status == _USABLE)] = _RETURNS
        self.usable = status == _USABLE
        self.results.put("frame_status", status)
        for value, said in _SAID.items():
            found = np.flatnonzero(status == value)
            if len(found):
                numbers = found + self.inputs.scene.recording.first_frame
                why = f" ({reasons[int(found[0])]})" if value == _UNREADABLE else ""
                self.inputs.warnings.append(
                    f"{_count(len(found))}, {_listed(numbers)}, {said}{why}: no result counts them, theirs are NaN "
                    f"(frame_status)"
                )
        if not self.usable.any():
            counts = ", ".join(f"{int((status == value).sum())} {said}" for value, said in _SAID.items() if value in status)
            raise FingerflowError(
                f"{self.inputs.recording.path}: none of {len(status)} frames is a picture that can be measured: "
                f"{counts}. Check the recording, [background] and [views.contact] of {self.inputs.scene.path}"
            )

    def _look(self, frames: NDArray[np.generic], view: View) -> Tensor:
        return _sampled(self.inputs.view(frames, view))


def _sampled(images: Tensor) -> Tensor:
    return images[..., _STEP // 2 :: _STEP, _STEP // 2 :: _STEP].float()


def _count(frames: int) -> str:
    return "1 frame" if frames == 1 else f"{frames} frames"


def _listed(numbers: NDArray[np.integer]) -> str:
    first = ", ".join(str(number) for number in numbers[:10])
    return first if len(numbers) <= 10 else f"{first} ..."
