"""Stick region from dense optical flow of the skin, checked against the displacement of tracked points."""

import math
from typing import Any, ClassVar

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from fingerflow.engines.torch import images_on
from fingerflow.kernels.array_types import Array, Field, Mask, Series
from fingerflow.models.partial_slip.stick_border import RampResponse
from fingerflow.pipeline.stages.contact.contact_stage import ContactStage
from fingerflow.pipeline.stages.slip.skin_flow import SkinFlow, flow_response
from fingerflow.pipeline.stages.slip.slip_grid import SlipGrid
from fingerflow.pipeline.stages.slip.slip_stage import SlipStage
from fingerflow.pipeline.stages.stage import Batch
from fingerflow.tracker.deviations.rigid_residual import MEDIAN_LENGTH

# Least difference of flow and points that gives a warning, in their standard deviations; smoothing, which these do not
# contain, makes up to 2 on the synthetic trials.
_DISAGREE = 4.0
_LEAST = 0.5  # least share of the skin in which the flow must be accepted in a frame
_BESIDE_PX = 12  # px, margin of skin around the cells with tracked points, for the flow at the border of these cells


class DenseFlowSlipStage(SlipStage):
    """Variant of `SlipStage` that measures displacement by dense optical flow ([slip] displacement = "dense_flow").

    In each frame the displacement of the points is compared with the flow at their positions in the first frame: median
    and 95th percentile of the difference. A warning is given where the median exceeds four times what their standard
    deviations allow.

    Comparison on ten of the trials of `python -m bench slip` (seeds 100, 107 ... 163; 920 frames), d² by the criterion
    "border":

    - points: within 0.02 in 82 % of the frames, error 0.015 RMS, worst frame 0.054; 33 ms of CPU a frame;
    - dense flow: 77 %, 0.016, 0.040; 67 ms of CPU a frame. It is too small by 0.007 on average. With noise of 1 to 2
      grey levels points are better; above 2 grey levels dense flow is better as often as not.

    This was with the power of slip fixed at 7/4 and before noise inside the stick region was distinguished from slip.

    The flow has less noise and averages over shorter distances: beside a stick region it shows 2 um where windows of 17
    px show 6, and sticking skin has 1.2 to 1.7 um of noise where single points have 2. So it is preferable for maps
    (`skin_displacement`), and for skin with few corners.
    """

    name = "dense_flow_slip"
    reads = ("gross_contact_region", "gross_contact_area_std")
    reads_frames = True
    settings: ClassVar[tuple[str, ...]] = (*SlipStage.settings, "views.topography")
    # Multiple of the noise for `StuckBorder`: the flow shows 2 to 3 um at the border, with noise of 1.2 to 1.7 um.
    clear = 3.0

    def begin(self) -> None:
        self._flow: SkinFlow | None = None
        self._flow_deviation, self._apart = np.full((2, len(self.trial)), np.nan)
        self._lost: list[int] = []
        super().begin()
        self.results.create("skin_displacement", self.trial.stage(ContactStage).cells())

    def step(self, batch: Batch) -> None:
        """Compute the dense flow of a batch of frames, then process the batch as `SlipStage` does."""
        if self._grid is not None and self._flow is not None:
            images = self._topography(batch.frames)
            for k, frame in enumerate(batch.indices):
                if self.usable[frame]:
                    self._follow(int(frame), images[k : k + 1], self._grid, self._flow)
        super().step(batch)

    def finish(self) -> None:
        super().finish()
        if self._flow is not None and self._flow.renewed:
            self.warnings.append(
                f"the skin could not be compared with the first frame to the end: {self._flow.renewed} later frames "
                f"took its place for the dense flow, whose errors add up"
            )
        if self._lost:
            self.warnings.append(
                f"in {len(self._lost)} frames, the first is {self._lost[0] + self.first_frame}, dense flow and light "
                f"explain less than half of the skin: it is left out there"
            )
        disagreeing = np.flatnonzero(self._apart > _DISAGREE)
        if len(disagreeing):
            worst, median = int(np.nanargmax(self._apart)), self.series["dense_flow_difference"]
            self.warnings.append(
                f"in {len(disagreeing)} frames dense flow and tracked points differ by more than {_DISAGREE:.0f} of "
                f"their standard deviations in the median, most in frame {worst + self.first_frame} "
                f"({1000 * median[worst]:.1f} µm): one of them is wrong. Look at the video, and take [slip] "
                f'displacement = "points" where the flow departs'
            )

    def _how_seen(self, grid: SlipGrid) -> RampResponse:
        """Prepare the dense flow; return the function that predicts the displacement that the flow measures near a slip
        border.
        """
        image = self._topography(self.inputs.recording[[0]].read())
        mask = self._pixel_mask(grid, (image.shape[-2], image.shape[-1]))
        quarter = self.inputs.scene.contact.gross_radius_px / 2 * self.inputs.mm_per_px
        self._flow = SkinFlow(image, mask, quarter / self.inputs.geometry.topography_mm_per_px)
        return flow_response(self._flow.template, image, mask, self.inputs.geometry.topography_mm_per_px)

    def _topography(self, frames: Array) -> Tensor:
        return images_on(self.inputs.device, self.inputs.scene.views["topography"].crop(frames))

    def _follow(self, frame: int, image: Tensor, grid: SlipGrid, flow: SkinFlow) -> None:
        """Compute the dense optical flow from the first frame to frame `frame`, store it at the contact cells, and
        compare it with the displacement of the tracked points.
        """
        moved = self.results["position"][frame : frame + 1][0][self._known] - grid.points
        back = np.linalg.inv(self._of_px).T
        pixels = self.inputs.geometry.on_topography(grid.points).astype(np.float32)
        motion = flow.follow(image, pixels, (moved @ back).astype(np.float32))
        both = np.dstack((motion.displacement, motion.variance))
        cells = _sampled(both, self.inputs.geometry.on_topography(grid.centers).astype(np.float32))
        if not np.isfinite(cells[grid.known, 2]).mean() >= _LEAST:
            self._lost.append(frame)
            return
        in_mm = cells[..., :2] @ self._of_px.T
        in_mm[~grid.known] = np.nan
        self.results["skin_displacement"][[frame]] = in_mm[None]
        self._flow_deviation[frame] = math.sqrt(float(np.nanmedian(cells[grid.known, 2])))
        self._compare(frame, moved, _sampled(both, pixels))

    def _compare(self, frame: int, moved: Series, flow: Field) -> None:
        """Store by how much the dense flow differs from the displacements `moved` (N, 2) mm of points in a frame:
        median and 95 % quantile in mm, and median in standard deviations.

        `flow` (N, 3) is sampled at the points: displacement, px, and its variance, px^2.
        """
        difference = np.linalg.norm(flow[:, :2] @ self._of_px.T - moved, axis=-1)
        valid = np.isfinite(difference)
        if not valid.any():
            return
        self.series["dense_flow_difference"][frame] = np.quantile(difference[valid], 0.5)
        self.series["dense_flow_difference_95"][frame] = np.quantile(difference[valid], 0.95)
        deviation = self.results["position_std_px"][frame : frame + 1][0][self._known].astype(np.float64)
        variance = flow[valid, 2] + np.square(deviation[valid])
        length = difference[valid] / (np.sqrt(variance) * self.inputs.geometry.topography_mm_per_px)
        if frame and np.isfinite(length).any():  # except in the first frame, which is compared with itself
            self._apart[frame] = np.nanmedian(length) / MEDIAN_LENGTH

    def _motion(self, frames: Any) -> Array:
        return self.results["skin_displacement"][frames]

    _measured = _motion

    def _point_displacement(self, motion: Array, grid: SlipGrid) -> Series:
        return np.asarray(grid.sample_points(grid.fine(motion.astype(np.float32, copy=False))), dtype=np.float64)

    def _cell_displacement(self, motion: Array, grid: SlipGrid) -> Field:
        """Return the dense-flow displacement (rows, columns, 2) mm at the contact cells of one frame, with gaps filled.

        Cells that are not known by points (`SlipGrid.known`) are 0; all are NaN where no cell is known.
        """
        valid = np.isfinite(motion).all(-1)
        if not valid.any():
            return np.full(motion.shape, np.nan, np.float32)
        row, column = distance_transform_edt(~valid, return_distances=False, return_indices=True)
        filled = motion[row, column].astype(np.float32)
        filled[~grid.known] = 0
        return filled

    def _positions(self, grid: SlipGrid) -> Array:
        return grid.centers

    def _noise_level(self, frame: int) -> float:
        return float(self._flow_deviation[frame])

    def _pixel_mask(self, grid: SlipGrid, shape: tuple[int, int]) -> Mask:
        """Return the mask (H, W) of the pixels of the topographic view that lie in contact cells near tracked points,
        dilated by `_BESIDE_PX`.
        """
        pixels = np.moveaxis(np.indices(shape)[::-1], 0, -1)
        cells = (self.inputs.geometry.on_glass(pixels) - grid.centers[0, 0]) / (4 * grid.fine_mm)
        column, row = cells.astype(np.float32).transpose(2, 0, 1)
        near = cv2.remap(grid.known.astype(np.uint8), column, row, cv2.INTER_NEAREST)
        side = 2 * _BESIDE_PX + 1
        return cv2.dilate(near, np.ones((side, side), np.uint8)) > 0


def _sampled(field: Field, pixels: Field) -> Field:
    """Interpolate a field (H, W, C) at positions (..., 2) px; NaN outside the field and next to NaN values."""
    x, y = (np.ascontiguousarray(pixels[..., k].reshape(-1, 1)) for k in (0, 1))
    values = cv2.remap(field, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(math.nan,) * 4)
    return np.asarray(values.reshape(*pixels.shape[:-1], -1), dtype=np.float32)
