"""What a trial is computed from, opened and checked: frames, background, forces, calibration."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fingerflow.errors import FingerflowError
from fingerflow.recordings import Recording, open_recording
from fingerflow.scene import Scene
from fingerflow.views import View

_REFERENCE_FRAMES = 64  # of a background recording are averaged: its noise is then an eighth of a frame's


@dataclass
class Inputs:
    """An opened scene on a device."""

    scene: Scene
    recording: Recording
    times: NDArray[np.float64]
    device: torch.device
    warnings: list[str]

    @property
    def mm_per_px(self) -> float:
        return self.scene.calibration.mm_per_px

    @property
    def topography_to_contact(self) -> NDArray[np.float64]:
        """(2, 3), px of the topography view to px of the contact view."""
        return np.asarray(self.scene.calibration.topography_to_contact, dtype=np.float64)

    def view(self, frames: NDArray[Any], view: View) -> Tensor:
        """A view of frames (n, H, W) as (n, 1, h, w) on the device. uint16 becomes int32, which torch can compute
        with."""
        part = np.ascontiguousarray(view.crop(frames))
        if part.dtype == np.uint16:
            part = part.astype(np.int32)
        return torch.from_numpy(part)[:, None].to(self.device)

    def reference(self, view: View) -> Tensor:
        """The view without a finger, (1, 1, h, w) float32."""
        return self._still(self.scene.background.frames, view)

    def dark(self, view: View) -> Tensor | None:
        """The view without light, where it was recorded."""
        return None if self.scene.background.dark is None else self._still(self.scene.background.dark, view)

    def _still(self, path: Any, view: View) -> Tensor:
        still = open_recording(path)
        if still.frame_shape != self.recording.frame_shape:
            raise FingerflowError(
                f"{path}: the background has frames of {_size(still.frame_shape)}, the recording "
                f"{self.recording.path} of "
                f"{_size(self.recording.frame_shape)}; record the background with the same camera settings"
            )
        mean = still[:_REFERENCE_FRAMES].read().mean(axis=0, dtype=np.float64)
        return torch.from_numpy(view.crop(mean).astype(np.float32))[None, None].to(self.device)


def open_inputs(scene: Scene, device: str) -> Inputs:
    """Opens the recording of a scene and checks that its views fit.

    Raises FingerflowError for what does not fit, with the value and the remedy.
    """
    chosen = ("cuda" if torch.cuda.is_available() else "cpu") if device == "auto" else device
    settings = scene.recording
    recording = open_recording(settings.frames, frame_rate=settings.frame_rate)
    if settings.first_frame >= len(recording):
        raise FingerflowError(
            f"{scene.path}: recording.first_frame is {settings.first_frame}, but {settings.frames} has "
            f"{len(recording)} "
            f"frames, 0 to {len(recording) - 1}"
        )
    warnings = list(recording.warnings)
    end = len(recording) if settings.last_frame is None else min(settings.last_frame + 1, len(recording))
    recording = recording[settings.first_frame : end]
    if recording.times is None:
        raise FingerflowError(
            f"{settings.frames} states no frame rate; give it in the scene, [recording] frame_rate = 300.0 (Hz)"
        )
    for view in (scene.views.contact, scene.views.topography):
        if view is not None:
            view.crop(np.empty(recording.frame_shape, dtype=np.uint8))
    return Inputs(scene, recording, np.asarray(recording.times, dtype=np.float64), torch.device(chosen), warnings)


def _size(shape: tuple[int, int]) -> str:
    return f"{shape[0]} rows x {shape[1]} columns"
