"""Real contact area by the steps printed in a paper (Willemet et al., 2021), for comparison with that paper."""

import numpy as np
from torch.nn import functional

from fingerflow.ops.contact.otsu import otsu_threshold
from fingerflow.ops.filters import illumination
from fingerflow.ops.filters.median import median_filter
from fingerflow.pipeline.stages.contact.contact_stage import ContactStage
from fingerflow.pipeline.stages.stage import Batch, Stage
from fingerflow.schema.variables import PRINTED_CONTACT

_MEDIAN_PX = 9


class PrintedContactStage(Stage):
    """Stage that measures the real contact area by the steps of a published figure (Willemet et al., 2021, S3 A).

    The intensity relative to the empty glass is subtracted from that at the first instant of contact. A median filter
    of 9 x 9 px and Otsu's threshold of every frame follow, and pixels are counted. The eroded area, by a unit diamond,
    follows the lab's code.

    `ContactStage` measures the same area better. Otsu's threshold of a whole frame depends on how much glass is in
    view, a median of 9 x 9 px rounds the ends of ridges, and skin in contact at the first instant is taken for glass. A
    frame in which `ContactStage` finds no contact is NaN here, as Otsu's threshold also splits the noise of an empty
    picture.
    """

    name = "printed_contact"
    gives = PRINTED_CONTACT
    needs = ("views.contact", "undistorted")
    after = (ContactStage,)
    reads_frames = True
    settings = ("contact.appears", "views.contact", "background", "calibration.mm_per_px")

    def begin(self) -> None:
        view = self.inputs.scene.views.contact
        self._reference, self._dark = self.inputs.reference(view), self.inputs.dark(view)
        self._touches = self.results["real_contact_area"][:] > 0
        self._first = self._normalized(self.inputs.recording[[int(np.argmax(self._touches))]].read())

    def step(self, batch: Batch) -> None:
        touches = self._touches[batch.indices]
        if not touches.any():
            return
        signal = illumination.contact_signal(self._normalized(batch.frames[touches]), self._first)
        levels = median_filter(illumination.quantize(signal), _MEDIAN_PX)
        threshold = otsu_threshold(levels)
        mask = levels > threshold.reshape(-1, 1, 1, 1)
        size = self.inputs.mm_per_px**2
        around = functional.pad(mask, (1, 1, 1, 1), value=True)
        eroded = mask & around[..., :-2, 1:-1] & around[..., 2:, 1:-1] & around[..., 1:-1, :-2] & around[..., 1:-1, 2:]
        values = {
            "printed_contact_threshold": illumination.dequantize(threshold.double()),
            "printed_real_contact_area": mask.sum((1, 2, 3)).double() * size,
            "printed_eroded_contact_area": eroded.sum((1, 2, 3)).double() * size,
        }
        for name, series in self.series.items():
            series[batch.indices[touches]] = values[name].cpu()

    def _normalized(self, frames: np.ndarray) -> illumination.NormalizedFrames:
        return illumination.normalize_illumination(self.inputs.contact_view(frames), self._reference, self._dark)
