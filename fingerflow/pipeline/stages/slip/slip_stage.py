"""Stick region of the contact in every frame, and classification of a trial with tangential loading."""

import json
import math
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
from scipy.ndimage import label
from scipy.spatial import cKDTree

from fingerflow.kernels.array_types import Array, Field, Mask, Series
from fingerflow.kernels.arrays import nanmedian
from fingerflow.models import partial_slip
from fingerflow.models.partial_slip.stick_border import RampResponse, blurred_ramp
from fingerflow.pipeline.stages.contact.contact_stage import ContactStage
from fingerflow.pipeline.stages.preparation.loading import LoadingStage
from fingerflow.pipeline.stages.slip.slip_grid import SlipGrid, growth_rates
from fingerflow.pipeline.stages.slip.stuck_border import FOLLOWED_MM, Length, StuckBorder
from fingerflow.pipeline.stages.stage import Batch, Stage
from fingerflow.pipeline.stages.tracking.tracking_stage import TrackingStage
from fingerflow.schema.json_value import json_value
from fingerflow.schema.scene import Scene
from fingerflow.schema.variables import SLIP
from fingerflow.tracker.area_steps import cut_shares
from fingerflow.tracker.vibration import FRAMES_READ, vibration

LEAST_COVERAGE = 0.9  # least share of the contact in which the displacement must be known
_MEDIAN_S = 0.07  # s, window of the running median of displacements: unbiased for skin that moves in one direction
_RATIO_NOISE = 0.006  # standard deviation of d^2 in a frame, measured on rendered trials
# Ratio of the least slip limit to the displacement of the contour along which displacements are averaged: noise may be
# half of it at most.
_CLEAR_OF_NOISE = 1 / 3
# Least slip limit in standard deviations of a displacement: below, one in twenty sticking points exceeds it.
_LEAST_LIMIT = 2.0


class SlipStage(Stage):
    """Stage that finds the stick region: the largest connected part of the gross contact that has not slipped so far.

    Displacement counts against the glass, which is at rest in the picture. [slip] criterion selects what sticks; d^2 is
    the area of the stick region over that of the contact:

    - "border": the border is where displacement begins, as the windows of the points show it (`StuckBorder`): the
      model's own d^2, whatever the law by which slip begins, with its deviation `stuck_ratio_std`. The law is fitted:
      see `docs/methods/slip.md` for errors and coverage on rendered trials of five laws (`python -m bench slip`).
    - "displacement": skin sticks that has moved by less than stuck_mm, 40 um in Terekhov & Hayward (2011). Skin beside
      the stick region has slipped by less than that too, so this d^2 is larger: by 0.15 to 0.22 at most on trials of
      `fingerflow.synthetic.PartialSlip` whose rim creeps by 0.6 to 1.4 mm. Coefficients of friction fitted to it are
      wrong.
    - "relative": the same, relative to the best rigid motion of the skin that stuck in the frame before, for moving
      glass. Skin that has come loose does not stick again. When the rest of the stick region comes loose as a whole
      (about a seventh of the contact in those trials), the view does not show it: that part stays stuck, and a verdict
      needs another criterion.

    [slip] displacement = "dense_flow" takes the displacement of all skin from dense flow instead of points
    (`DenseFlowSlipStage`).

    The paper's d^2, by 0.04 mm, stands beside it as `printed_stuck_ratio`.

    Noise of single points limits d² only where slip begins slowly. What limits it is one shift for all frames of a
    trial: laws that differ within a window beside the border look alike.

    mu_k / mu_s = (1 - 2 A) / (1 - A), with the critical area A, is known to 5 % if A is known to
    0.05 mu_k / mu_s (1 - A)²: 0.005 at a ratio of 0.3, 0.011 at 0.5, and 0.02 only above 0.69. With 72 frames of
    loading, d² of the last frame before the loss is 0.08 above A at a ratio of 0.5.

    A fit that contradicts the verdict is marked as not identified.
    """

    name = "slip"
    gives = SLIP
    reads: ClassVar[tuple[str, ...]] = ("gross_contact_region", "gross_contact_area_std", "deformation_correction_px")
    needs = ("views.topography", "undistorted")
    after = (LoadingStage, ContactStage, TrackingStage)
    settings: ClassVar[tuple[str, ...]] = (
        *("slip", "tracking.window_px", "contact.gross_radius_px", "recording.times", "recording.first_frame"),
        *("calibration.mm_per_px", "calibration.topography_to_contact", "forces"),
    )
    # Multiple of the noise for `StuckBorder`, 0 to follow the fitted level. A contour above the noise of points that is
    # then moved inside is no better: where slip begins as x^2 and the level at the border equals the noise, it gave a
    # d^2 that was too large by 0.025 on rendered trials.
    clear = 0.0

    @classmethod
    def variant(cls, scene: Scene) -> type[Stage]:
        variants = {subclass.name: subclass for subclass in cls.__subclasses__()}
        return variants.get(f"{scene.slip.displacement}_slip", cls)

    def begin(self) -> None:
        contact, frames = self.trial.stage(ContactStage), len(self.trial)
        self._settings = self.inputs.scene.slip
        self._growth = np.full((2, frames), np.nan)  # mm² a frame, of the leading and the trailing half
        self._pull = np.zeros(2)  # mm, sum of all displacements, towards which the skin moves over the glass
        self._deviation = np.full(frames, np.nan)  # px, as from `_noise_level`
        self._edge = np.zeros(frames, dtype=bool)  # frames whose contact reaches the edge of the view
        step = float(np.median(np.diff(self.inputs.times))) if frames > 1 else 1.0
        self._beside = round(_MEDIAN_S / 2 / step)  # number of frames on either side of a running median
        # (2, 2) matrix from px of the topographic view to mm.
        self._of_px = self.inputs.geometry.topography_to_contact[:, :2] * self.inputs.mm_per_px
        self._area = self.results["gross_contact_area"][:]
        shape = self.results["gross_contact_region"].shape[1:]
        self._reach = self.inputs.scene.tracking.window_px / 2 * self.inputs.geometry.topography_mm_per_px
        self._first = np.asarray(self.results["position"][slice(0, 1)])[0]
        self._known = np.isfinite(self._first).all(-1)
        self._grid: SlipGrid | None = None
        self._border: StuckBorder | None = None
        try:
            self._grid = SlipGrid(self._first[self._known], shape, **contact.cells(), reach_mm=self._reach)
        except ValueError as error:
            self.warnings.append(f"{error}: the stuck area is NaN. Raise [tracking] points")
        else:
            seen = self._how_seen(self._grid)
            if self._settings.criterion == "border":
                self._border = StuckBorder(self._grid, self._reach, seen, self.clear)
        self.results.create("stuck_region", contact.cells())

    def step(self, batch: Batch) -> None:
        """Add a batch of frames to the fit of the stick border; store which share of the contact is tracked."""
        if self._grid is None:
            return
        regions, motion = self.results["gross_contact_region"][batch.indices], self._motion(batch.indices)
        measured = motion if self._border is None else self._measured(batch.indices)
        self._pull += np.nansum(motion.reshape(-1, 2), axis=0)
        for k, frame in enumerate(batch.indices):
            region = regions[k] > 0
            if not region.any() or not np.isfinite(self._area[frame]):
                continue
            self._edge[frame] = cut_shares(region[None], self._area[[frame]])[0] > 0
            self._deviation[frame] = self._noise_level(frame)
            seen = self._positions(self._grid) + motion[k]
            if len(seen := seen[np.isfinite(seen).all(-1)]):
                distance, _ = cKDTree(seen).query(self._grid.centers[region])
                self.series["slip_coverage"][frame] = (distance <= self._reach).mean()
            if self._border is not None:
                self._border.gather(*self._points_and_cells(measured[k], self._grid), region)

    def _how_seen(self, grid: SlipGrid) -> RampResponse:
        """Return the function that predicts the displacement which tracking, averaging over a window, measures at
        signed distances (mm) from a slip border beyond which the true one increases linearly.
        """
        return partial(blurred_ramp, half_window=self._reach)

    def _motion(self, frames: Any) -> Array:
        """Return the displacement (n, N, 2) mm of the skin at N points since the first frame; NaN if unknown."""
        return self.results["position"][frames][:, self._known] - self._first[self._known]

    def _measured(self, frames: Any) -> Array:
        """Return the displacement (n, N, 2) mm since the first frame that the windows of N points show near a slip
        border: its mean over each window.

        The tracker subtracts a correction for a curvature that it measures over most of the contact. Beside a border of
        slip the curvature is another one, so the correction is left out.
        """
        corrections = self.results["deformation_correction_px"]
        now, first = (corrections[part][:, self._known] @ self._of_px.T for part in (frames, slice(0, 1)))
        return self._motion(frames) + now - first

    def _points_and_cells(self, motion: Array, grid: SlipGrid) -> tuple[Series, Field]:
        """Return the displacement of the skin in one frame, (N, 2) mm at the points and (rows, columns, 2) mm over the
        contact cells.
        """
        return self._point_displacement(motion, grid), self._cell_displacement(motion, grid)

    def _point_displacement(self, motion: Array, grid: SlipGrid) -> Series:
        """Return the displacement (N, 2) mm, in one frame, of the skin at the first-frame positions of the points."""
        return motion

    def _cell_displacement(self, motion: Array, grid: SlipGrid) -> Field:
        """Return the displacement (rows, columns, 2) mm of the skin at the grid cells of the contact in one frame."""
        return grid.displacement(motion)

    def _positions(self, grid: SlipGrid) -> Array:
        """Return the positions (..., 2) mm in the first frame of the skin whose displacement `_motion` returns."""
        return grid.points

    def _noise_level(self, frame: int) -> float:
        """Return the median over all points of the standard deviation, px, of a displacement component by image noise
        in one frame.
        """
        return float(nanmedian(self.results["position_noise_px"][frame : frame + 1])[0])

    def finish(self) -> None:
        settings, border = self._settings, self._border
        if self._grid is not None:
            if border is not None:
                border.settle()
            criterion = border or Length(self._grid, settings.stuck_mm, settings.criterion == "relative")
            for first in range(0, len(self.trial), FRAMES_READ):
                self._find_stuck(first, min(first + FRAMES_READ, len(self.trial)), self._grid, criterion)
        self._warn_of_unknown()
        self._warn_of_noise()
        if settings.criterion != "relative":
            where = self.results["in_contact"], np.flatnonzero(self.usable), self.inputs.geometry.topography_mm_per_px
            self.warnings += vibration(self.results["position"], *where, "skin that sticks is taken to slip")[1]
        forces, ratio = self.known("load_ratio"), self.series["stuck_ratio"]
        # By the error of the stick border's position, the border being taken as a circle.
        position_std = math.nan if border is None else border.position_std
        deviation = np.sqrt(4 * np.pi * ratio / self._area * position_std**2 + _RATIO_NOISE**2)
        self.series["stuck_ratio_std"] = deviation
        verdict = self._judged(ratio, forces, deviation)
        parts: dict[str, Any] = {"verdict": verdict}
        if verdict.collapse_frame >= 0 and forces is not None:
            slow = verdict.loading()
            parts["friction_fit"] = verdict.check_fit(partial_slip.fit_friction(ratio[slow], forces[slow]))
            parts["curves"] = partial_slip.compare_curves(ratio[slow], forces[slow])
        judged = {name: json.dumps(json_value(part), ensure_ascii=False) for name, part in parts.items()}
        limit = {"criterion": settings.criterion, "stuck_mm": self._limit()}
        power = {} if not (border and border.fit) else {"power": border.fit.power, "power_std": border.fit.power_std}
        self.about |= {"stuck_area": limit, "stuck_ratio": limit | power | judged}
        self.about["printed_stuck_ratio"] = {"stuck_mm": settings.stuck_mm}
        ridge_mm = 2 * self.inputs.scene.contact.gross_radius_px * self.inputs.mm_per_px
        area_std = self.results["gross_contact_area_std"][:]
        self.series["stuck_area"] = ratio * self._area
        self.series["stuck_area_std"] = np.hypot(self._area * deviation, ratio * area_std)
        rates, rates_std = growth_rates(self._growth, self.inputs.times, self._area, area_std, ridge_mm)
        self.series |= {"leading_area_rate": rates[0], "trailing_area_rate": rates[1]}
        self.series |= {"leading_area_rate_std": rates_std[0], "trailing_area_rate_std": rates_std[1]}

    def _limit(self) -> float:
        """Return the displacement, mm, below which skin counts as stuck; NaN if this limit is unknown."""
        if self._settings.criterion != "border":
            return self._settings.stuck_mm
        return math.nan if self._border is None else self._border.level

    def _find_stuck(self, first: int, end: int, grid: SlipGrid, criterion: "StuckBorder | Length") -> None:
        """Find the stick region in frames `first` to `end` - 1."""
        start, stop = max(0, first - max(self._beside, 1)), min(len(self.trial), end + self._beside)
        motion = self._motion(slice(start, stop))
        measured = self._measured(slice(start, stop)) if criterion is self._border else motion
        regions = self.results["gross_contact_region"][slice(start, stop)] > 0
        printed = Length(grid, self._settings.stuck_mm, relative=False)
        stuck = np.zeros((end - first, *regions.shape[1:]), dtype=bool)
        for k, frame in enumerate(range(first, end)):
            region = regions[frame - start]
            # Skip a contact at the edge of the view, which is only partly visible.
            if not self.series["slip_coverage"][frame] >= LEAST_COVERAGE or self._edge[frame]:
                continue
            # Take as many frames on either side, so that the median has no lag.
            side = min(self._beside, frame, len(self.trial) - 1 - frame)
            around = slice(frame - side - start, frame + side + 1 - start)
            moved, displacement = self._points_and_cells(_settled(motion[around]), grid)
            if not np.isfinite(displacement[grid.known]).all():
                continue
            fine = _largest(criterion.stuck(*self._points_and_cells(_settled(measured[around]), grid), region))
            self.series["stuck_ratio"][frame] = grid.share(fine, region)
            by_length = _largest(printed.stuck(moved, displacement, region))
            self.series["printed_stuck_ratio"][frame] = grid.share(by_length, region)
            stuck[k] = grid.cells(fine) & region
            if frame > start:
                earlier, later = (self._point_displacement(motion[at - start], grid) for at in (frame - 1, frame))
                self._growth[:, frame] = grid.growth((regions[frame - 1 - start], region), earlier, later, self._pull)
        self.results["stuck_region"][slice(first, end)] = stuck

    def _judged(self, ratio: Series, forces: Series | None, deviation: Series) -> partial_slip.TrialVerdict:
        start = "in the first frame, from which displacement counts: set [recording] first_frame"
        cut = "the contact reaches the edge of the view in the first frame: its area is not known; make [views] wider"
        reasons = {
            "there is no contact in any frame": not np.nanmax(self._area, initial=0.0) > 0,
            f"there is no contact {start}": not self._area[0] > 0,
            "there are no forces: the scene has no [forces] table": self.inputs.scene.forces is None,
            "there is no tangential force: name its channel in [forces] tangential": forces is None,
            cut: self._edge[0],
            "the displacement is known in too little of the contact in every frame": np.isnan(ratio).all(),
        }
        reason = next((reason for reason, applies in reasons.items() if applies), "")
        if reason or forces is None:
            return partial_slip.TrialVerdict("inconclusive", reason, "inconclusive", frames_missing=len(self.trial))
        verdict = partial_slip.judge_trial(ratio, forces, self.inputs.times, deviation)
        if verdict.outcome == "inconclusive" and self._edge.any():
            left = f"; the contact reaches the edge of the view in {int(self._edge.sum())} frames, whose d² is NaN"
            return replace(verdict, reason=verdict.reason + left)
        return verdict

    def _warn_of_noise(self) -> None:
        """Warn if displacement noise reaches the slip limit, so that resting skin would be classified as slipped."""
        limit = self._limit() if self._border is None else FOLLOWED_MM * _CLEAR_OF_NOISE
        deviation = float(np.nanmedian(self._deviation)) if np.isfinite(self._deviation).any() else math.nan
        noise = math.sqrt(2) * deviation * self.inputs.geometry.topography_mm_per_px
        if limit < _LEAST_LIMIT * noise:
            self.warnings.append(
                f"displacements of single points have a standard deviation of {1000 * noise:.1f} µm, and skin that has "
                f"moved by {1000 * self._limit():.1f} µm counts as slipped: where the stuck part ends is not known. "
                f'Record with more light, raise [tracking] window_px, or take [slip] criterion = "displacement" with a '
                f"larger stuck_mm"
            )

    def _warn_of_unknown(self) -> None:
        if self._border is not None and self._border.reason:
            least = f"{1000 * FOLLOWED_MM:.0f} µm"
            self.warnings.append(f"{self._border.reason}: skin that has moved by less than {least} is taken for stuck")
        coverage = self.series["slip_coverage"]
        low = np.flatnonzero(coverage < LEAST_COVERAGE)
        if len(low):
            first = int(low[0]) + self.first_frame
            self.warnings.append(
                f"in {len(low)} frames, the first is {first}, the displacement since the first frame is known in less "
                f"than {LEAST_COVERAGE:.0%} of the contact, down to {np.min(coverage[low]):.0%}: their stuck "
                f"area is NaN. Points were lost there, or skin came into contact that was in no point's window: raise "
                f"[tracking] points or search_px"
            )


def _settled(motion: Array) -> Array:
    """Return the median (N, 2) of displacements (n, N, 2) over the frames around a frame.

    A frame is used only together with its mirror frame: where one side is lost, the other alone would give a lag.
    """
    return nanmedian(np.where(np.isfinite(motion[::-1]), motion, np.nan)[None])[0]


def _largest(fine: Mask) -> Mask:
    """Return the largest 8-connected part of a mask (H, W), or the first in reading order of equally large ones."""
    parts, _ = label(fine, np.ones((3, 3)))
    return fine & (parts == np.bincount(parts[fine], minlength=1).argmax())
