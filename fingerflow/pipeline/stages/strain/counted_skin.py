"""Selection of the triangles on which strain is computed, with reference position and frame of each corner."""

import numpy as np
from scipy.spatial import Delaunay, QhullError

from fingerflow.kernels.array_types import Array, Mask, Numbers, Points
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.pipeline.stages.deformation.deformation_stage import DeformationStage
from fingerflow.pipeline.stages.tracking.tracking_stage import TrackingStage
from fingerflow.results.store import Store, Values
from fingerflow.tracker.deformation import Displacement
from fingerflow.tracker.entry import LEAST_AREA
from fingerflow.tracker.recorded.new_skin import LEFT
from fingerflow.tracker.recorded.stored_frames import values_at

# Deviation of a place of onset, relative to the root of twice a triangle's area, from which it distorts the triangle.
_ERROR = 0.05


class CountedSkin:
    """Triangles of tracked points on which strain is computed, each with one reference frame for all three corners.

    Separate corners belong to triangles with advected skin, or whose shape by positions of onset differs from that of
    the skin. Each corner is then a point of its own, which counts from the frame in which the last of the three has
    touched. So the triangle has one reference, and no strain comes from the difference of two.

    Attributes:
        triangles: (M, 3) indices of points; those with advected skin are the last.
        corners: (M, 3) the same as indices of the P points and corners here.
        begins: (M,) frame from which a triangle counts.
        ends: (M,) frame from which it counts no more, as its skin was gone when a finger touched again.
        since: (P,) frame from which a point counts.
        reference: (P, 2) mm, position then; NaN for points that are in no triangle by their own reference, as advected
            ones.
        positions_px: (P, 2) the same, px of the topographic view.
        noise: (P,) mm^2, as `DeformationStage.noise`.
        of_onset: (P, 2, 2) mm^2, as there; 0 where a frame is the reference.
        independent: (P,) as there.
        shape: (P, 2, 2) of the ellipse of a position's errors: its covariance over its mean variance.
        by_onsets: as there.
    """

    def __init__(self, stage: DeformationStage, results: Store, frames: int) -> None:
        self._stage, self._position, self.by_onsets = stage, stage.steady_position, stage.by_onsets
        onset = np.where(stage.onset < 0, frames, stage.onset)
        reference = stage.reference.copy()
        reference[stage.entered] = np.nan
        skins = [(np.ones(len(onset), bool), frames)]
        if not stage.trial.stage(TrackingStage).backward:
            skins = _skins(results["status"], stage.seeded)
        both: list[list[Array]] = []
        for points, end in skins:
            plain, separate = triangulate(np.where(points[:, None], reference, np.nan)), self._advected(points)
            if stage.by_onsets:
                distorted = self._distorted_by_onsets(plain, onset[plain].max(1, initial=0), reference)
                plain, separate = plain[~distorted], np.concatenate([plain[distorted], separate])
            both.append([plain, separate, np.full(len(plain), end), np.full(len(separate), end)])
        plain, separate, *ends = (np.concatenate(parts) for parts in zip(*both, strict=True))
        self.triangles = np.concatenate([plain, separate])
        self.begins = onset[self.triangles].max(1, initial=0)
        self.ends = np.concatenate(ends)
        # Corners of the separate triangles.
        self._points, self._since = separate.flatten(), np.repeat(self.begins[len(plain) :], 3)
        self.corners = np.concatenate([plain, len(onset) + np.arange(len(self._since), dtype=np.int32).reshape(-1, 3)])
        self.since = np.concatenate([stage.begins, self._since])
        self._then = values_at(self._position, self._since, self._points)
        noise_px = values_at(results["position_noise_px"], self._since, self._points)
        self._variance = (noise_px * stage.mm_per_px) ** 2
        self.reference = np.concatenate([reference, self._then])
        self.positions_px = stage.inputs.geometry.on_topography(self.reference)
        self.noise = np.concatenate([stage.noise, stage.noise[self._points]])
        self.of_onset = np.concatenate([stage.of_onset, np.zeros((len(self._since), 2, 2))])
        self.independent = np.concatenate([stage.independent, np.zeros(len(self._since))])
        along, across = results["position_anisotropy"][:].T
        shape = np.stack((1 + along, across, across, 1 - along), axis=1).reshape(-1, 2, 2)
        self.shape = np.concatenate([shape, shape[self._points]])

    def _advected(self, points: Mask) -> Array:
        """Return the triangles (M, 3) of touching `points` (N,) with a corner that was advected into the contact."""
        stage = self._stage
        triangles = triangulate(np.where((points & (stage.onset >= 0))[:, None], stage.common_position, np.nan))
        return triangles[np.isin(triangles, stage.entered).any(1)]

    def _distorted_by_onsets(self, triangles: Array, begins: Numbers, reference: Points) -> Mask:
        """Return the mask (M,) of triangles whose reference shape is distorted because each corner counts from its own
        onset of contact, so that the corners never formed this shape in one frame.

        Compared with the skin in the frame in which the last corner touches, such a triangle is shrunk or stretched in
        some direction by more than a factor of `LEAST_AREA`. This too is a difference of two references. So is one
        with a corner whose place of onset errs by much of the triangle's size.
        """
        touched = np.flatnonzero(begins < self._position.shape[0])
        corners = triangles[touched]
        then = values_at(self._position, np.repeat(begins[touched], 3), corners.flatten()).reshape(-1, 3, 2)
        by_onset, of_skin = (corners_of[:, 1:] - corners_of[:, :1] for corners_of in (reference[corners], then))
        square = np.trace(self._stage.of_onset, axis1=1, axis2=2)[corners].max(1)
        result = np.zeros(len(triangles), dtype=bool)
        result[touched] = square > _ERROR**2 * abs(np.linalg.det(np.nan_to_num(by_onset)))
        regular = np.isfinite(of_skin).all((1, 2)) & (abs(np.linalg.det(np.nan_to_num(of_skin))) > 1e-12)
        stretches = np.linalg.svd(np.linalg.solve(of_skin[regular], by_onset[regular]), compute_uv=False)
        result[touched[regular]] |= (stretches[:, 1] < LEAST_AREA) | (stretches[:, 0] > 1 / LEAST_AREA)
        return result

    def moved(self, moved: Displacement, frames: Numbers) -> tuple[Points, Array, Array]:
        """Return displacements (n, P, 2) mm, and variances (n, P) mm^2 by image noise and by curvature, in n frames of
        the tracked points, followed by copies of points that are corners of triangles with another reference frame.
        """
        stage, points = self._stage, self._points
        counts = (frames[:, None] >= self._since) & np.isfinite(moved.displacement[:, points]).all(-1)
        separate = np.where(counts[..., None], self._position[frames][:, points] - self._then, np.nan)
        # Half of a position's variance is noise of its template, the same in every frame, as for all points.
        noise = (stage.tracked_variance(frames, "position_noise_px")[:, points] + self._variance) / 2
        noise = np.where(frames[:, None] == self._since, 0, noise).astype(np.float32)
        pairs = (moved.displacement, separate), (moved.variance, noise), (moved.curvature, moved.curvature[:, points])
        displacement, variance, curvature = (np.concatenate(pair, axis=1) for pair in pairs)
        return displacement, variance, curvature


def _skins(status: Values, seeded: Numbers) -> list[tuple[Mask, int]]:
    """Return the masks (N,) of the points of each skin that was tracked forward by itself, and the frame from which the
    next takes its place, from the track `status` (F, N) and the frames (N,) in which points were `seeded`.

    A finger that touches again elsewhere, or with other skin, has left hardly a point tracked (`LEFT`). Points that are
    lost then would form triangles with the new ones, whose strain is unknown. Those still tracked belong to both.
    """
    first, *later = np.unique(seeded).tolist() or [0]
    result: list[tuple[Mask, int]] = []
    present = seeded == first
    for frame in later:
        earlier = seeded < frame
        tracked = earlier & (status[frame : frame + 1][0] == TrackStatus.TRACKED)
        if tracked.sum() < LEFT * earlier.sum():
            result.append((present, frame))
            present = tracked
        present |= seeded == frame
    return [*result, (present, status.shape[0])]


def triangulate(positions: Points) -> Array:
    """Return Delaunay triangles (M, 3) of all points with finite positions; none if the points span no area."""
    finite = np.flatnonzero(np.isfinite(positions).all(-1)).astype(np.int32)
    try:
        return finite[Delaunay(positions[finite]).simplices]
    except (QhullError, ValueError):  # fewer than three points, or all on one line
        return np.zeros((0, 3), dtype=np.int32)
