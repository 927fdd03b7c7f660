"""Contact of every frame: real and gross area, ellipse, and the region by which points come into contact."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fingerflow.errors import FingerflowError
from fingerflow.graphs import Contact, ContactGraph, LightGraph
from fingerflow.ops.cells import mask_of
from fingerflow.ops.light_gain import light_gain
from fingerflow.ops.morphology import dilate
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
_STEP = 4  # px between the pixels that are looked at
_STEADY = 0.01  # change of the lamp that moves no area


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

    def __init__(self, inputs: Inputs, normal_force: NDArray[np.float64] | None, keeps_regions: bool = False) -> None:
        """With `keeps_regions` the gross region of every frame stays, in `regions`."""
        settings = inputs.scene.contact
        self._inputs = inputs
        self.recording = inputs.recording
        self._view = inputs.scene.views.contact
        self._graph = inputs.engine(ContactGraph(settings.median_px, settings.gross_radius_px))
        unknown = torch.full((1,), torch.nan, device=inputs.device)
        light = inputs.engine(LightGraph())
        self._light, self._black, _ = light(inputs.reference(self._view), inputs.dark(self._view), unknown)
        self.reference_frame = self._most_contact(normal_force)
        self._threshold = self._fixed_threshold()
        count = len(inputs.recording)
        self._gain = np.full(count, np.nan)  # of the lamp
        height, width = (-(-side // self._graph.cell_px) for side in self._view.shape)
        #: (frames, h, w) the gross region on cells of `cell_px` px; no frames where it is not kept.
        self.regions = np.zeros((count if keeps_regions else 0, height, width), dtype=bool)
        self._blind = np.zeros(count, dtype=bool)  # frames with contact and without glass
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
        contact, threshold = self._contact(frames)
        size = self._inputs.mm_per_px
        series = self.series
        series.threshold[indices] = threshold.cpu()
        series.real_area[indices] = contact.real_area_px.double().cpu() * size**2
        series.gross_area[indices] = contact.gross_area_px.double().cpu() * size**2
        series.center[indices] = contact.center.double().cpu() * size
        series.semi_axes[indices] = contact.semi_axes.double().cpu() * size
        series.angle[indices] = contact.angle.cpu()
        if len(self.regions):
            self.regions[indices] = (contact.density_margin[:, 0] > 0).cpu()
        self._gain[indices] = contact.light_gain.cpu()
        self._blind[indices] = (contact.light_gain.isnan() & (contact.real_area_px > 0)).cpu()
        return contact

    def finish(self) -> None:
        """Warns of frames in which the lamp may have changed, and nothing tells by how much."""
        known = self._gain[np.isfinite(self._gain)]
        if self._blind.any() and (not len(known) or np.abs(known - 1).max() > _STEADY):
            first = int(np.argmax(self._blind)) + self._inputs.scene.recording.first_frame
            self._inputs.warnings.append(
                f"the light changes, but {int(self._blind.sum())} frames, the first is {first}, show no empty glass to "
                f"tell by how much: their areas are those of steady light. Leave some glass free around the finger, or "
                f"record the empty glass again"
            )

    @property
    def cell_px(self) -> int:
        """Side of the cells of `regions`, px."""
        return self._graph.cell_px

    def largest(self) -> Tensor:
        """The gross region (1, 1, h, w) bool of the reference frame, the one with most contact."""
        return self._region_of(self.reference_frame)

    def first_and_largest(self, margin_px: int) -> Tensor:
        """(1, 1, h, w) bool, also the region of the first frame, which a contact that slides has left by then; with a
        margin, so that there are points on both sides of the border of the contact."""
        return dilate(self._region_of(0) | self.largest(), margin_px)

    def _region_of(self, frame: int) -> Tensor:
        contact, _ = self._contact(self._inputs.recording[[frame]].read())
        return mask_of(contact.density_margin, self._graph.cell_px, *contact.real_contact_mask.shape[2:])

    def _contact(self, frames: NDArray[np.generic]) -> tuple[Contact, Tensor]:
        view = self._inputs.view(frames, self._view)
        if self._threshold is None:
            threshold = self._graph.threshold(view, self._light, self._black)
        else:
            threshold = torch.full((len(view),), self._threshold, dtype=self._light.dtype, device=view.device)
        return self._graph(view, self._light, self._black, 1 - threshold), threshold

    def _most_contact(self, normal_force: NDArray[np.float64] | None) -> int:
        if normal_force is not None and np.isfinite(normal_force).any():
            return int(np.nanargmax(normal_force))
        count = len(self._inputs.recording)
        looks = np.unique(np.linspace(0, count - 1, min(count, _LOOKS)).round().astype(int))
        light = [self._brightness(self._inputs.recording[[int(i)]].read()) for i in looks]
        return int(looks[int(np.nanargmin(light))]) if np.isfinite(light).any() else 0

    def _brightness(self, frame: NDArray[np.generic]) -> float:
        """Mean light of a frame as a share of the empty glass's, the lamp's brightness taken out; NaN where hardly any
        is left, as in a dark frame: a contact leaves half."""
        view: Tensor = self._inputs.view(frame, self._view)
        some, given, dark = (image[..., ::_STEP, ::_STEP] for image in (view, self._light, self._black))
        light = float(((some - dark) / given.clamp_min(1)).clamp(0, 1)[given > 0].mean())
        gain = float(light_gain(view, self._light, self._black, self._graph.gross_radius_px))
        return light / (gain if np.isfinite(gain) else 1) if light > _LEAST_LIGHT else float("nan")

    def _fixed_threshold(self) -> float | None:
        """Relative intensity loss that counts as contact; None where every frame has its own."""
        setting = self._inputs.scene.contact.threshold
        if setting == "per_frame":
            return None
        if not isinstance(setting, str):
            return float(setting)
        frame = self._inputs.view(self._inputs.recording[[self.reference_frame]].read(), self._view)
        threshold = float(self._graph.threshold(frame, self._light, self._black))
        if not np.isfinite(threshold):
            raise FingerflowError(
                f"{self._inputs.recording.path}: no finger is in view. In frame {self.reference_frame}, where "
                f"most contact was "
                f"expected, no part of the contact view is darker than the background by more than its noise. Check "
                f"[views.contact] and [background] in {self._inputs.scene.path}, or set [contact] threshold to "
                f"a number."
            )
        return threshold
