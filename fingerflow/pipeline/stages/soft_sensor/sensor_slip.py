"""Partial and gross slip of an object on a soft sensor, measured by markers in the contact."""

import numpy as np
import torch
from numpy.typing import NDArray

from fingerflow.ops.fields.rigid_motion import rigid_residual
from fingerflow.pipeline.stages.contact.contact_stage import ContactStage
from fingerflow.pipeline.stages.displacement.displacement_stage import DisplacementStage
from fingerflow.pipeline.stages.soft_sensor.sensor_markers import MarkerStage
from fingerflow.pipeline.stages.stage import RunContext, Stage
from fingerflow.pipeline.stages.tracking.tracking_stage import TrackingStage
from fingerflow.schema.variables import SENSOR_SLIP

_FEWEST = 3  # least number of markers for the fit of a rigid motion
_FITS = 4  # iterations of the reweighted fit
_LET_GO = 1 / 3  # share of the mean displacement in contact that is lost in one frame at gross slip
_SHEARED = 0.1  # spacings, mean displacement below which no such loss is detected
_TOGETHER = 0.75  # least share of the markers in contact that move back at gross slip

Array = NDArray[np.float64]


class SensorSlipStage(Stage):
    """Stage that measures the share of the markers in contact that have slipped, and detects gross slip.

    Where the object sticks, the gel under it moves with it as a rigid body. The slip ratio is the share of the markers
    in contact whose displacement since they were touched differs from the best rigid motion by more than
    `slip.stuck_mm`. The fit reduces the weight of outliers, so that the sticking majority determines it (rigid fit
    after Dong et al. 2019, "Maintaining grasps within slipping bound by monitoring incipient slip"). A gel that spreads
    under a growing normal force counts as slip too.

    Gross slip is flagged where the gel springs back: from one frame to the next the markers that were in contact lose
    at least a third of their mean displacement, most of them together. Then the object slides, or releases the gel
    while it is sheared; markers alone cannot distinguish these. The flag needs the frame before, but none after. An
    object that slides at constant friction moves no marker and is not detected.
    """

    name = "sensor_slip"
    gives = SENSOR_SLIP
    needs = ("soft_sensor",)
    after = (ContactStage, TrackingStage, DisplacementStage, MarkerStage)
    settings = ("slip.stuck_mm", "calibration.mm_per_px")

    def __init__(self, trial: RunContext) -> None:
        super().__init__(trial)
        self._limit = self.inputs.scene.slip.stuck_mm

    def finish(self) -> None:
        spacing = self.trial.stage(MarkerStage).spacing * self.inputs.mm_per_px
        moved, touches = self.results["displacement"][:], self.results["in_contact"][:] > 0
        touches &= self.trial.stage(ContactStage).series["gross_contact_area"][:, None] > 0
        reference = torch.from_numpy(self.trial.stage(DisplacementStage).reference)[None]
        frames = len(moved)
        ratio, mean, gross = np.full(frames, np.nan), np.full((frames, 2), np.nan), np.zeros(frames, dtype=np.uint8)
        start = np.full(moved.shape[1:], np.nan)  # mm, displacement at which the present touch of each marker began
        for frame in range(frames):
            start[~touches[frame]] = np.nan
            start = np.where(np.isnan(start) & touches[frame][:, None], moved[frame], start)
            known = touches[frame] & np.isfinite(moved[frame]).all(-1)
            if known.any():
                mean[frame] = moved[frame][known].mean(0)
            ratio[frame] = self._slipped_share(reference, np.where(known[:, None], moved[frame] - start, np.nan))
            if frame:
                before, now = (moved[k][touches[frame - 1]] for k in (frame - 1, frame))
                gross[frame] = _springs_back(before, now, spacing)
        self.results.put("slip_ratio", ratio, {"stuck_mm": self._limit})
        self.results.put("contact_displacement", mean)
        self.results.put(
            "gross_slip", gross, {"share_lost": round(_LET_GO, 4), "least_mm": round(_SHEARED * spacing, 4)}
        )

    def _slipped_share(self, reference: torch.Tensor, moved: Array) -> float:
        """Return the share of markers with known displacement `moved` (N, 2) mm that do not follow the rigid motion of
        the majority; `reference` holds the rest positions. NaN for too few markers.
        """
        known = np.isfinite(moved).all(-1)
        if known.sum() < _FEWEST:
            return float("nan")
        given, off = torch.from_numpy(moved)[None], np.zeros(len(moved))
        for _ in range(_FITS):
            weights = torch.from_numpy(self._limit / np.maximum(np.nan_to_num(off), self._limit))[None]
            off = rigid_residual(reference, given, weights)[0].norm(dim=-1).numpy()
        return float((off[known] > self._limit).mean())


def _springs_back(before: Array, now: Array, spacing: float) -> bool:
    """Return whether a sheared gel springs back: most markers lose much of their displacement from one frame (`before`,
    (N, 2)) to the next (`now`).
    """
    known = np.isfinite(before).all(-1) & np.isfinite(now).all(-1)
    if known.sum() < 2:
        return False
    before, now = before[known], now[known]
    sheared = before.mean(0)
    length = float(np.linalg.norm(sheared))
    if length < _SHEARED * spacing:
        return False
    lost = (before - now) @ sheared / length
    return bool(lost.mean() >= _LET_GO * length and (lost > 0).mean() >= _TOGETHER)
