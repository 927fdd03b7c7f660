"""Contact of every frame: real and gross area, ellipse, and the region by which points come into contact."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fingerflow.errors import FingerflowError
from fingerflow.graphs import Contact, ContactGraph
from fingerflow.stages.inputs import Inputs

GIVES = frozenset(
    {
        "contact_threshold",
        "real_contact_area",
        "gross_contact_area",
        "ellipse_center",
        "ellipse_semi_axes",
        "ellipse_angle",
    }
)
_LEAST_LIGHT = 0.1
_LOOKS = 32  # frames that are looked at to find the one with most contact, where no forces tell


@dataclass
class ContactSeries:
    """Contact of all frames, in mm and mm^2; NaN ellipses where there is no contact."""

    threshold: NDArray[np.float64]
    real_area: NDArray[np.float64]
    gross_area: NDArray[np.float64]
    center: NDArray[np.float64]
    semi_axes: NDArray[np.float64]
    angle: NDArray[np.float64]


class ContactStage:
    """Runs the contact graph over batches of frames; keeps numbers, never pictures."""

    def __init__(self, inputs: Inputs, normal_force: NDArray[np.float64] | None) -> None:
        settings = inputs.scene.contact
        self._inputs = inputs
        self.recording = inputs.recording
        self._view = inputs.scene.views.contact
        self._graph = inputs.engine(ContactGraph(settings.median_px, settings.gross_radius_px))
        self._reference = inputs.reference(self._view)
        self._dark = inputs.dark(self._view)
        self.reference_frame = self._most_contact(normal_force)
        self._threshold = self._fixed_threshold()
        count = len(inputs.recording)
        self.series = ContactSeries(
            threshold=np.full(count, np.nan),
            real_area=np.full(count, np.nan),
            gross_area=np.full(count, np.nan),
            center=np.full((count, 2), np.nan),
            semi_axes=np.full((count, 2), np.nan),
            angle=np.full(count, np.nan),
        )

    def run(self, indices: NDArray[np.intp], frames: NDArray[np.generic]) -> Contact:
        """Contact of the frames (n, H, W) with these numbers; also written into the series."""
        contact = self._contact(frames)
        size = self._inputs.mm_per_px
        series = self.series
        series.threshold[indices] = contact.threshold.cpu()
        series.real_area[indices] = contact.real_area_px.cpu() * size**2
        series.gross_area[indices] = contact.gross_area_px.cpu() * size**2
        series.center[indices] = contact.ellipse.center.cpu() * size
        series.semi_axes[indices] = contact.ellipse.semi_axes.cpu() * size
        series.angle[indices] = contact.ellipse.angle.cpu()
        return contact

    def largest(self) -> Contact:
        """Contact of the reference frame, the one with most of it."""
        return self._contact(self._inputs.recording[[self.reference_frame]].read())

    def _contact(self, frames: NDArray[np.generic]) -> Contact:
        view = self._inputs.view(frames, self._view)
        threshold = None
        if self._threshold is not None:
            threshold = torch.full((len(view),), self._threshold, dtype=torch.float64, device=view.device)
        return self._graph(view, self._reference, self._dark, threshold)

    def _most_contact(self, normal_force: NDArray[np.float64] | None) -> int:
        if normal_force is not None and np.isfinite(normal_force).any():
            return int(np.nanargmax(normal_force))
        count = len(self._inputs.recording)
        looks = np.unique(np.linspace(0, count - 1, min(count, _LOOKS)).round().astype(int))
        light = [self._light(self._inputs.recording[[int(i)]].read()) for i in looks]
        return int(looks[int(np.nanargmin(light))]) if np.isfinite(light).any() else 0

    def _light(self, frame: NDArray[np.generic]) -> float:
        """Mean light of a frame as a share of the background's; NaN where hardly any is left, as in a dark frame: a
        contact leaves half."""
        view: Tensor = self._inputs.view(frame, self._view)
        light = float((view / self._reference.clamp_min(1)).clamp(0, 1).mean())
        return light if light > _LEAST_LIGHT else float("nan")

    def _fixed_threshold(self) -> float | None:
        """Share of light lost that counts as contact; None where every frame has its own."""
        setting = self._inputs.scene.contact.threshold
        if setting == "per_frame":
            return None
        if not isinstance(setting, str):
            return float(setting)
        frame = self._inputs.view(self._inputs.recording[[self.reference_frame]].read(), self._view)
        threshold = float(self._graph.threshold(frame, self._reference, self._dark))
        if not np.isfinite(threshold):
            raise FingerflowError(
                f"{self._inputs.recording.path}: no finger is in view. In frame {self.reference_frame}, where "
                f"most contact was "
                f"expected, no part of the contact view is darker than the background by more than its noise. Check "
                f"[views.contact] and [background] in {self._inputs.scene.path}, or set [contact] threshold to "
                f"a number."
            )
        return threshold
