"""Which part of the contact sticks to the glass, and what becomes of it in a trial of tangential loading."""

from dataclasses import dataclass, replace

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
from fingerflow.stages.contact import ContactSeries
from fingerflow.stages.deformation import glass_positions
from fingerflow.stages.inputs import Inputs
from fingerflow.stages.loading import Loading
from fingerflow.stages.tracking import TrackSeries

GIVES = frozenset({"stuck_area", "stuck_ratio", "stuck_region", "slip_coverage"})
LEAST_COVERAGE = 0.9  # of the contact in which the displacement must be known


@dataclass
class SlipSeries:
    """The stuck part of every frame, and the verdict of the trial.

    Attributes:
        stuck_area: (F,) mm^2; NaN without contact, and where too little of it is known.
        stuck_ratio: (F,) d^2, the stuck area over the gross contact area.
        region: (F, h, w) bool, the stuck part on cells of `cell_px` px of the contact view.
        coverage: (F,) share of the gross contact that a tracked point's window shows; NaN without contact.
        verdict: of Terekhov & Hayward's rule.
        fit, curves: of the frames of slow loading, where there is a verdict; else None.
    """

    stuck_area: NDArray[np.float64]
    stuck_ratio: NDArray[np.float64]
    region: NDArray[np.bool_]
    cell_px: int
    coverage: NDArray[np.float64]
    verdict: TrialVerdict
    fit: FrictionFit | None
    curves: CurveComparison | None


def find_slip(
    inputs: Inputs,
    tracks: TrackSeries,
    contact: ContactSeries,
    regions: NDArray[np.bool_],
    cell_px: int,
    loading: Loading | None,
) -> SlipSeries:
    """The stuck part as Terekhov & Hayward (2011) take it: the largest connected part of the gross contact whose skin
    has moved by less than a length since the first frame.

    Displacement counts against the glass, which rests in the picture. Skin beside the part that has not slipped at all
    has slipped by less than that length too, so this d^2 is larger than the model's: on trials of
    `fingerflow.synthetic.PartialSlip` whose rim creeps by 0.6 to 1.4 mm by 0.15 to 0.22 at most with 40 um, by 0.05 to
    0.08 with 10 um. Below, the windows of the tracked points, which straddle the border, make it too small. With 40 um
    an area that fades at mu_k of 1.0 to 1.2 mu_s is judged to vanish abruptly. Coefficients of friction that are
    fitted to it are wrong: a fit that contradicts the T/N at which adhesion was lost is marked as not identified,
    others deserve no more trust than d^2.

    Args:
        regions: (F, h, w) the gross contact on cells of cell_px px of the contact view.
    """
    position = glass_positions(inputs, tracks.position)
    moved = position - position[0]
    y, x = (np.arange(size) * cell_px + (cell_px - 1) / 2 for size in regions.shape[1:])
    places = np.stack(np.meshgrid(x, y), axis=-1) * inputs.mm_per_px
    scale = inputs.mm_per_px * np.sqrt(abs(np.linalg.det(inputs.topography_to_contact[:, :2])))
    reach = inputs.scene.tracking.window_px / 2 * float(scale)
    ratio, coverage = np.full(len(moved), np.nan), np.full(len(moved), np.nan)
    stuck = np.zeros_like(regions)
    for frame in np.flatnonzero(regions.any((1, 2)) & np.isfinite(contact.gross_area)):
        region = regions[frame]
        displacement, distance = displacement_at(places[region], position[frame], moved[frame])
        coverage[frame] = (distance <= reach).mean()
        if coverage[frame] >= LEAST_COVERAGE:
            still = np.zeros_like(region)
            still[region] = np.linalg.norm(displacement, axis=-1) < inputs.scene.slip.stuck_mm
            stuck[frame] = largest_component(torch.from_numpy(still)[None, None])[0, 0]
            ratio[frame] = int(stuck[frame].sum()) / int(region.sum())
    _warn_of_unknown(inputs, coverage)
    verdict = _judged(inputs, contact, loading, ratio)
    fit, curves = None, None
    if verdict.outcome != "inconclusive" and loading is not None and loading.ratio is not None:
        slow = verdict.loading()
        fit = _consistent(fit_friction(ratio[slow], loading.ratio[slow]), verdict)
        curves = compare_curves(ratio[slow], loading.ratio[slow])
    return SlipSeries(ratio * contact.gross_area, ratio, stuck, cell_px, coverage, verdict, fit, curves)


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


def _judged(
    inputs: Inputs, contact: ContactSeries, loading: Loading | None, ratio: NDArray[np.float64]
) -> TrialVerdict:
    reason = ""
    if not np.nanmax(contact.gross_area, initial=0.0) > 0:
        reason = "there is no contact in any frame"
    elif not contact.gross_area[0] > 0:
        reason = "there is no contact in the first frame, from which displacement counts: set [recording] first_frame"
    elif loading is None:
        reason = "there are no forces: the scene has no [forces] table"
    elif loading.ratio is None:
        reason = "there is no tangential force: name its channel in [forces] tangential"
    elif not np.isfinite(ratio).any():
        reason = "the displacement is known in too little of the contact in every frame"
    if reason or loading is None or loading.ratio is None:
        return TrialVerdict("inconclusive", reason, "inconclusive", frames_missing=len(ratio))
    return judge_trial(ratio, loading.ratio, inputs.times)


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


def _warn_of_unknown(inputs: Inputs, coverage: NDArray[np.float64]) -> None:
    low = np.flatnonzero(coverage < LEAST_COVERAGE)
    if len(low):
        first = int(low[0]) + inputs.scene.recording.first_frame
        inputs.warnings.append(
            f"in {len(low)} frames, the first is {first}, the displacement since the first frame is known in less than "
            f"{LEAST_COVERAGE:.0%} of the contact, down to {np.min(coverage[low]):.0%}: their stuck area is NaN. "
            f"Points were lost there, or skin came into contact that was in no point's window: raise [tracking] points "
            f"or search_px"
        )
