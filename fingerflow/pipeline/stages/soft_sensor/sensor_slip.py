"""Partial and gross slip of what touches a soft sensor, from the markers in the contact."""

import numpy as np
import torch
from numpy.typing import NDArray

from fingerflow.ops.fields.rigid_motion import rigid_residual
from fingerflow.pipeline.stages.contact.contact import ContactStage
from fingerflow.pipeline.stages.displacement.displacement import DisplacementStage
from fingerflow.pipeline.stages.soft_sensor.markers import MarkerStage
from fingerflow.pipeline.stages.stage import Stage, Trial
from fingerflow.pipeline.stages.tracking.tracking import TrackingStage
from fingerflow.schema.variables import SENSOR_SLIP

_FEWEST = 3  # markers by which a rigid motion can be told from another one
_FITS = 4  # of which each gives what lies off the one before less weight
_LET_GO = 1 / 3  # of the displacement in contact, lost in one frame
_SHEARED = 0.1  # spacings of displacement, below which there is none to lose
_TOGETHER = 0.75  # of the markers in contact, that go back

Array = NDArray[np.float64]


class SensorSlipStage(Stage):
    """A share of the contact that has slipped, and a flag of gross slip.

    Where the object sticks, the gel under it moves with it as one rigid body. The share is that of the markers in
    contact whose displacement since they were touched departs from the best rigid motion by more than [slip] stuck_mm;
    the fit gives what is off it less weight, so that the stuck majority decides (Dong et al. 2019, "Maintaining grasps
    within slipping bound by monitoring incipient slip", has the rigid fit). A gel that is pressed harder spreads, which
    counts too.

    Gross slip is flagged where the gel springs back: from one frame to the next the markers that were in contact lose
    at least a third of their mean displacement, most of them together. So the object slides, or lets go of the gel
    while it is sheared, which markers alone cannot tell apart. The flag needs the frame before and none after. An
    object that slides at a constant friction moves no marker: it is not seen.
    """

    name = "sensor_slip"
    gives = SENSOR_SLIP
    needs = ("soft_sensor",)
    after = (ContactStage, TrackingStage, DisplacementStage, MarkerStage)
    settings = ("slip.stuck_mm", "calibration.mm_per_px")

    def __init__(self, trial: Trial) -> None:
        super().__init__(trial)
        self._limit = self.inputs.scene.slip.stuck_mm

    def finish(self) -> None:
        spacing = self.trial.stage(MarkerStage).spacing * self.inputs.mm_per_px
        moved, touches = self.results["displacement"][:], self.results["in_contact"][:] > 0
        touches &= self.trial.stage(ContactStage).series["gross_contact_area"][:, None] > 0
        reference = torch.from_numpy(self.trial.stage(DisplacementStage).reference)[None]
        frames = len(moved)
        ratio, mean, gross = np.full(frames, np.nan), np.full((frames, 2), np.nan), np.zeros(frames, dtype=np.uint8)
        start = np.full(moved.shape[1:], np.nan)  # displacement when the present touch began
        for frame in range(frames):
            start[~touches[frame]] = np.nan
            start = np.where(np.isnan(start) & touches[frame][:, None], moved[frame], start)
            known = touches[frame] & np.isfinite(moved[frame]).all(-1)
            if known.any():
                mean[frame] = moved[frame][known].mean(0)
            ratio[frame] = self._departed(reference, np.where(known[:, None], moved[frame] - start, np.nan))
            if frame:
                before, now = (moved[k][touches[frame - 1]] for k in (frame - 1, frame))
                gross[frame] = _springs_back(before, now, spacing)
        self.results.put("slip_ratio", ratio, {"stuck_mm": self._limit})
        self.results.put("contact_displacement", mean)
        self.results.put(
            "gross_slip", gross, {"share_lost": round(_LET_GO, 4), "least_mm": round(_SHEARED * spacing, 4)}
        )

    def _departed(self, reference: torch.Tensor, moved: Array) -> float:
        """Share of the markers whose displacement (N, 2) mm is not that of the rigid motion of most."""
        known = np.isfinite(moved).all(-1)
        if known.sum() < _FEWEST:
            return float("nan")
        given, off = torch.from_numpy(moved)[None], np.zeros(len(moved))
        for _ in range(_FITS):
            weights = torch.from_numpy(self._limit / np.maximum(np.nan_to_num(off), self._limit))[None]
            off = rigid_residual(reference, given, weights)[0].norm(dim=-1).numpy()
        return float((off[known] > self._limit).mean())


def _springs_back(before: Array, now: Array, spacing: float) -> bool:
    """Whether markers lose much of their displacement (N, 2) mm from one frame to the next."""
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
