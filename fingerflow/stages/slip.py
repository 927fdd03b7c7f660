"""Which part of the contact sticks to the glass, and what becomes of it in a trial of tangential loading."""

import json
import math
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.interpolate import CloughTocher2DInterpolator
from scipy.spatial import QhullError, cKDTree

from fingerflow.models.partial_slip import (
    CurveComparison,
    FrictionFit,
    TrialVerdict,
    compare_curves,
    critical_load_ratio,
    fit_friction,
    judge_trial,
)
from fingerflow.models.partial_slip.verdict import CORRIDOR
from fingerflow.ops.components import largest_component
from fingerflow.player.contract.variables import SLIP
from fingerflow.stages.contact import ContactStage
from fingerflow.stages.loading import LoadingStage
from fingerflow.stages.stage import Batch, Stage, Trial
from fingerflow.stages.tracking import TrackingStage

LEAST_COVERAGE = 0.9  # of the contact in which the displacement must be known


class SlipStage(Stage):
    """The stuck part as Terekhov & Hayward (2011) take it: the largest connected part of the gross contact whose skin
    has moved by less than a length since the first frame.

    Displacement counts against the glass, which rests in the picture. Skin beside the part that has not slipped at all
    has slipped by less than that length too, so this d^2 is larger than the model's: on trials of
    `fingerflow.synthetic.PartialSlip` whose rim creeps by 0.6 to 1.4 mm by 0.15 to 0.22 at most with 40 um, by 0.05 to
    0.08 with 10 um. Below, the windows of the tracked points, which straddle the border, make it too small. With 40 um
    an area that fades at mu_k of 1.0 to 1.2 mu_s is judged to vanish abruptly. Coefficients of friction that are
    fitted to it are wrong: a fit that contradicts the T/N at which adhesion was lost is marked as not identified,
    others deserve no more trust than d^2.
    """

    name = "slip"
    gives = SLIP
    reads = ("gross_contact_region",)
    needs = ("views.topography",)
    after = (LoadingStage, ContactStage, TrackingStage)
    follows_border = True

    def __init__(self, trial: Trial) -> None:
        super().__init__(trial)
        self._ratio, self._coverage = np.full((2, len(trial)), np.nan)
        self._limit = self.inputs.scene.slip.stuck_mm

    def begin(self) -> None:
        contact = self.trial.stage(ContactStage)
        self._area = contact.series["gross_contact_area"]
        rows, columns = self.results["gross_contact_region"].shape[1:]
        y, x = (np.arange(size) * contact.cell_px + (contact.cell_px - 1) / 2 for size in (rows, columns))
        self._places = np.stack(np.meshgrid(x, y), axis=-1) * self.inputs.mm_per_px
        self._reach = self.inputs.scene.tracking.window_px / 2 * self.inputs.topography_mm_per_px
        self._first = self.results["position"][slice(0, 1)]
        self.results.create("stuck_region", contact.cells())

    def step(self, batch: Batch) -> None:
        regions, positions = (self.results[name][batch.indices] for name in ("gross_contact_region", "position"))
        stuck = np.zeros(regions.shape, dtype=bool)
        for k, frame in enumerate(batch.indices):
            region = regions[k] > 0
            if not region.any() or not np.isfinite(self._area[frame]):
                continue
            moved = positions[k] - self._first[0]
            displacement, distance = displacement_at(self._places[region], positions[k], moved)
            self._coverage[frame] = (distance <= self._reach).mean()
            if self._coverage[frame] >= LEAST_COVERAGE:
                still = np.zeros_like(region)
                still[region] = np.linalg.norm(displacement, axis=-1) < self._limit
                stuck[k] = largest_component(torch.from_numpy(still)[None, None])[0, 0]
                self._ratio[frame] = int(stuck[k].sum()) / int(region.sum())
        self.results["stuck_region"][batch.indices] = stuck

    def finish(self) -> None:
        self._warn_of_unknown()
        forces = self.trial.stage(LoadingStage).ratio
        verdict = self._judged(forces)
        parts: dict[str, TrialVerdict | FrictionFit | CurveComparison] = {"verdict": verdict}
        if verdict.outcome != "inconclusive" and forces is not None:
            slow = verdict.loading()
            parts["friction_fit"] = _consistent(fit_friction(self._ratio[slow], forces[slow]), verdict)
            parts["curves"] = compare_curves(self._ratio[slow], forces[slow])
        judged = {name: json.dumps(_plain(asdict(part)), ensure_ascii=False) for name, part in parts.items()}
        limit = {"stuck_mm": self._limit}
        self.results.put("stuck_area", self._ratio * self._area, limit)
        self.results.put("stuck_ratio", self._ratio, limit | judged)
        self.results.put("slip_coverage", self._coverage)

    def _judged(self, forces: NDArray[np.float64] | None) -> TrialVerdict:
        reason = ""
        if not np.nanmax(self._area, initial=0.0) > 0:
            reason = "there is no contact in any frame"
        elif not self._area[0] > 0:
            reason = (
                "there is no contact in the first frame, from which displacement counts: set [recording] first_frame"
            )
        elif self.inputs.scene.forces is None:
            reason = "there are no forces: the scene has no [forces] table"
        elif forces is None:
            reason = "there is no tangential force: name its channel in [forces] tangential"
        elif not np.isfinite(self._ratio).any():
            reason = "the displacement is known in too little of the contact in every frame"
        if reason or forces is None:
            return TrialVerdict("inconclusive", reason, "inconclusive", frames_missing=len(self._ratio))
        return judge_trial(self._ratio, forces, self.inputs.times)

    def _warn_of_unknown(self) -> None:
        low = np.flatnonzero(self._coverage < LEAST_COVERAGE)
        if len(low):
            first = int(low[0]) + self.inputs.scene.recording.first_frame
            self.inputs.warnings.append(
                f"in {len(low)} frames, the first is {first}, the displacement since the first frame is known in less "
                f"than {LEAST_COVERAGE:.0%} of the contact, down to {np.min(self._coverage[low]):.0%}: their stuck "
                f"area is NaN. Points were lost there, or skin came into contact that was in no point's window: raise "
                f"[tracking] points or search_px"
            )


def displacement_at(
    places: NDArray[np.float64], points: NDArray[np.float64], moved: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Displacement (Q, 2) of the skin at places (Q, 2), from that (N, 2) of points (N, 2), and the distance (Q,) from
    the nearest of them; all in mm.

    By the smooth surface through the points (Clough & Tocher 1965). Plane fits over as few points as determine them
    blunt the border of the stuck part, which takes up to 0.036 from d^2 where this is off by 0.019; noise, which they
    would average, is a hundredth of the length that matters. Beyond the outermost points the nearest one counts.

    Points with a NaN are left out. Where the others do not span an area, displacements are NaN and distances infinite.
    """
    nothing = np.full(places.shape, np.nan), np.full(len(places), np.inf)
    known = np.isfinite(points).all(-1) & np.isfinite(moved).all(-1)
    if known.sum() < 3:
        return nothing
    points, moved = points[known], moved[known]
    try:
        result = np.asarray(CloughTocher2DInterpolator(points, moved)(places))
    except QhullError:  # all on one line
        return nothing
    distance, nearest = cKDTree(points).query(places)
    beyond = ~np.isfinite(result).all(-1)
    result[beyond] = moved[nearest[beyond]]
    return result, distance


def _consistent(fit: FrictionFit, verdict: TrialVerdict) -> FrictionFit:
    """The fit; not identified where its curve does not lose adhesion at the T/N at which the trial did."""
    if not fit.identified:
        return fit
    critical = float(critical_load_ratio(fit.mu_s, fit.mu_k))
    if abs(critical / verdict.loss_load_ratio - 1) <= CORRIDOR:
        return fit
    reason = (
        f"the fitted curve loses adhesion at T/N {critical:.2f}, the trial did at {verdict.loss_load_ratio:.2f}: d² is "
        f"not that of the model; try a smaller [slip] stuck_mm"
    )
    return replace(fit, identified=False, reason=reason)


def _plain(value: Any) -> Any:
    """What JSON can say: null for NaN."""
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(part) for part in value]
    return None if isinstance(value, float) and math.isnan(value) else value
