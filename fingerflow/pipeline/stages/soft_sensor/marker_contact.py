"""Contact region of a soft sensor, from brightness changes of the gel and displacements of the markers."""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fingerflow.ops.contact.components import fill_holes, largest_component
from fingerflow.ops.contact.ellipse import fit_ellipse
from fingerflow.ops.contact.light_change import light_change
from fingerflow.ops.contact.otsu import otsu_threshold
from fingerflow.ops.filters.morphology import dilate
from fingerflow.pipeline.stages.contact.contact_stage import ContactStage
from fingerflow.pipeline.stages.preparation.loading import LoadingStage
from fingerflow.pipeline.stages.soft_sensor.sensor_markers import MarkerStage
from fingerflow.pipeline.stages.stage import Batch, RunContext

CELL_PX = 4
_LOOKS = 32  # number of sampled frames; the one with the largest change of light sets the threshold
_REST_FRAMES = 16  # number of averaged frames at rest
_HIDDEN = 2.2  # masked radius around a marker, in detection scales: its disc has 1.4, its blurred border the rest
_LEAST_CHANGE = 0.03  # least relative change of light in contact; at rest noise and compression change it by 0.01
_LEAST_MOVED = 0.05  # spacings, least displacement of the gel in contact; a released gel creeps back by less
# Ratio of the displacement at the border of a uniformly loaded circle to that in its centre, whatever the gel's
# stiffness (Johnson 1985, section 3.4).
_AT_BORDER = 2 / math.pi
_WIDTH = 0.5  # spacings, standard deviation of the Gaussian over which displacements are averaged
_LEAST_AREA = 0.25  # square spacings, least area of a contact


class MarkerContactStage(ContactStage):
    """Stage that finds the gross contact of a soft sensor: the largest region in which brightness changed or the gel
    moved.

    Light becomes brighter or darker where the gel's surface is tilted; both count. The threshold is that of Otsu (1979)
    in the sampled frame with the largest change. Where a flat or soft object tilts nothing, the contact is the region
    that moves by at least 2/pi of the largest displacement. That region extends beyond the object, so the area of such
    a frame is approximate. Micro-junctions are not visible: the real area is NaN.
    """

    name = "marker_contact"
    instead = True
    views = ()
    after = (LoadingStage, MarkerStage)
    settings = ("contact.threshold", "views.contact", "calibration.mm_per_px")

    def __init__(self, trial: RunContext) -> None:
        super().__init__(trial)
        self.cell_px = CELL_PX

    def begin(self) -> None:
        self._follow()
        still = np.flatnonzero(self._markers.at_rest)
        still = still[np.argsort(np.abs(still - self._markers.rest_frame), kind="stable")][:_REST_FRAMES]
        self._rest = self._pictures(np.sort(still)).to(torch.float32).mean(0, keepdim=True)
        self._least_change = self._light_threshold()
        if "gross_contact_region" in self.trial.asked:
            rows, columns = self._cells.shape[:2]
            self.results.create("gross_contact_region", self.cells(), cell_row=rows, cell_column=columns)

    def begin_as(self, other: "MarkerContactStage") -> None:
        """Begin with the rest image and brightness threshold that another stage measured in the same recording."""
        self._follow()
        self._rest, self._least_change = other._rest, other._least_change

    def _follow(self) -> None:
        self._markers = self.trial.stage(MarkerStage)
        rows, columns = (side // CELL_PX for side in self._view.shape)
        y, x = (np.arange(size) * CELL_PX + (CELL_PX - 1) / 2 for size in (rows, columns))
        self._cells = np.stack(np.meshgrid(x, y), axis=-1)

    def step(self, batch: Batch) -> NDArray[np.bool_]:
        """Find the contact region in a batch of frames, store it, and return it as masks (n, h, w) of cells."""
        assert batch.frames is not None
        view = self.inputs.view(batch.frames, self._view)
        change = self._brightness_change(view, batch.indices)
        moved = np.stack([self._displaced_cells(frame) for frame in batch.indices])
        lit = largest_component(fill_holes(change.abs() > self._least_change))
        large = lit.sum((1, 2, 3), keepdim=True) * CELL_PX**2 >= _LEAST_AREA * self._markers.spacing**2
        region = torch.where(large, lit, largest_component(torch.from_numpy(moved)[:, None].to(lit.device)))
        ellipse, size = fit_ellipse(region), self.inputs.mm_per_px
        for name, values in {
            "contact_threshold": torch.full_like(ellipse.angle, self._least_change),
            "gross_contact_area": ellipse.area_px * (CELL_PX * size) ** 2,
            "ellipse_center": (ellipse.center * CELL_PX + (CELL_PX - 1) / 2) * size,
            "ellipse_semi_axes": ellipse.semi_axes * CELL_PX * size,
            "ellipse_angle": ellipse.angle,
        }.items():
            self.series[name][batch.indices] = values.cpu()
        cells: NDArray[np.bool_] = region[:, 0].cpu().numpy()
        if "gross_contact_region" in self.results:
            self.results["gross_contact_region"][batch.indices] = cells
        return cells

    def finish(self) -> None:
        self.reference_frame = int(np.argmax(self.series["gross_contact_area"]))
        if not self.series["gross_contact_area"].any():
            self.warnings.append(
                f"no contact was found in any frame: no light changes by more than {self._least_change:.0%}, and no "
                f"marker moves by {_LEAST_MOVED:g} of their spacing"
            )
        for name, values in self.series.items():
            self.results.put(name, values)

    def _pictures(self, frames: NDArray[np.intp]) -> Tensor:
        parts = [self.inputs.recording[[int(k)]].read() for k in frames]
        return self.inputs.view(np.concatenate(parts), self._view)

    def _light_threshold(self) -> float:
        setting = self.inputs.scene.contact.threshold
        if not isinstance(setting, str):
            return float(setting)
        count = len(self.trial)
        looks = np.unique(np.linspace(0, count - 1, min(count, _LOOKS)).round().astype(int))
        change = self._brightness_change(self._pictures(looks), looks).abs().flatten(1)
        most = change[change.nanquantile(0.95, dim=1).argmax()]
        levels = (most[most.isfinite()].clamp_max(0.5) * 510).round().to(torch.uint8)
        threshold = float(otsu_threshold(levels[None, None, None]).reshape(())) / 510 if len(levels) else 0.0
        return max(threshold, _LEAST_CHANGE)

    def _brightness_change(self, view: Tensor, frames: NDArray[np.intp]) -> Tensor:
        """Return the brightness change (n, 1, h, w) of each cell since the gel was at rest, from pixels between the
        markers.

        It is 0 in cells that show nothing but markers.
        """
        hidden = torch.zeros(view.shape, dtype=torch.bool)
        for k, frame in enumerate(frames):
            for points in (self._markers.found[frame], self._markers.found[self._markers.rest_frame]):
                x, y = points.round().long().unbind(-1)
                hidden[k, 0, y.clamp(0, view.shape[2] - 1), x.clamp(0, view.shape[3] - 1)] = True
        hidden = dilate(hidden, math.ceil(_HIDDEN * self._markers.look.scale)).to(view.device)
        return light_change(view, self._rest, hidden, CELL_PX, self._markers.look.scale).nan_to_num(0.0)

    def _displaced_cells(self, frame: int) -> NDArray[np.bool_]:
        """Return the mask (h, w) of cells in which the gel, interpolated between the markers, has moved since rest by
        at least 2/pi of its largest displacement in the frame, and by more than it creeps.
        """
        points = self._markers.points[frame]
        moved = points - self._markers.rest
        known = np.isfinite(moved).all(-1)
        none = np.zeros(self._cells.shape[:2], dtype=bool)
        if not known.any():
            return none
        distance = ((self._cells[:, :, None] - points[known]) ** 2).sum(-1)
        weight = np.exp(-distance / (2 * (_WIDTH * self._markers.spacing) ** 2)) + 1e-300
        length = np.linalg.norm(weight @ moved[known] / weight.sum(-1)[..., None], axis=-1)
        least = max(_LEAST_MOVED * self._markers.spacing, _AT_BORDER * float(length.max()))
        result: NDArray[np.bool_] = length >= least
        return result
