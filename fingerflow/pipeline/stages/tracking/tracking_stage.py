"""Tracking of skin points through all frames, in the topographic view."""

from typing import Any, ClassVar

import cv2
import numpy as np
import torch
from scipy.spatial import cKDTree

from fingerflow.engines.contact_view import covers
from fingerflow.engines.engine import Images, TrackedPoints, noise_of, select
from fingerflow.errors import FingerflowError, NoRoomError
from fingerflow.kernels.array_types import Array, Mask, Numbers
from fingerflow.kernels.arrays import nanmedian
from fingerflow.kernels.field_limits import LEAST_SHARE
from fingerflow.kernels.tracking_limits import WARP_GAUGE_PX, TrackStatus
from fingerflow.pipeline.stages.contact.contact_stage import ContactStage
from fingerflow.pipeline.stages.preparation import plausibility, ridges
from fingerflow.pipeline.stages.preparation.frame_check import FrameCheckStage
from fingerflow.pipeline.stages.preparation.inputs import SCALE_KEYS, read_frames, region_mask
from fingerflow.pipeline.stages.stage import Batch, RunContext, Stage
from fingerflow.pipeline.stages.tracking.new_skin import LEFT, NewSkin, on_topography
from fingerflow.results.free_space import size_of_results
from fingerflow.schema.variables import TRACKING
from fingerflow.tracker.point_prediction import PointMotion
from fingerflow.tracker.points import MOST_FRAMES, Points, join

_SHARPEN_PX = 1.0  # px, radius of the unsharp mask; that of the lab's code
# Least difference of an impulse from its surroundings, as a share of the range and in standard deviations of noise.
_IMPULSE, _BEYOND_NOISE = 0.2, 8.0
_FEWEST = 3  # least number of points for a gradient
_FEW = 5  # frames in which a contact that moves is noticed
_CORRECTION = "deformation_correction_px"
MOST_SEEDED = 3  # largest number of points seeded in a recording, as a multiple of `tracking.points`


class TrackingStage(Stage):
    """Stage that tracks points from frame to frame, forward or backward in time.

    With key frames every frame is compared with the first one, whose template is deformed by the motion gradient found
    so far: errors do not accumulate. With the previous frame as template they do.

    Where skin comes into contact that lay outside the first seeding region (`NewSkin`), points are seeded in the last
    frame of a batch, which is their key frame. In the frames before they have the status NOT_SEEDED_YET. A press has no
    such points.
    """

    name = "tracking"
    gives = TRACKING
    needs = ("views.topography",)
    same_pass = (ContactStage,)
    after: ClassVar[tuple[type[Stage], ...]] = (FrameCheckStage,)
    reads_frames = True
    settings = (
        *("kind", "tracking", "views.topography", "stream.region", "background", "recording.first_frame"),
        *("contact.appears", "contact.gross_radius_px", *SCALE_KEYS, "calibration.topography_to_contact"),
    )

    def __init__(self, trial: RunContext) -> None:
        super().__init__(trial)
        inputs, self._view = self.inputs, self.inputs.scene.views["topography"]
        self._settings = inputs.scene.tracking
        self.backward = self._settings.direction == "backward"
        self._engine = inputs.engine
        self._to_contact = inputs.geometry.topography_to_contact
        self._matrix = self._to_contact.astype(np.float32)
        self._seeded: list[Points] = []
        # For each set of points: indices (A,) of earlier points that guide it.
        self._around: list[Numbers] = []
        self._density = 0.0  # points per px of the first seeding region
        self._new_skin = NewSkin(inputs.geometry, self._engine.cell_px, self._settings.window_px)
        self._full = False  # True if no more points may be seeded
        self._region = np.zeros((0, 0), bool)  # (h, w) px of the contact view, seeding region
        self._held = np.full(len(trial), np.nan)

    def begin(self) -> None:
        """Find the contact region in which points are to be seeded, and warn if no contact is found."""
        contact = self.trial.stage(ContactStage)
        self._region = contact.seeding_region(self._settings.window_px)
        if not self._region.any():
            self.warnings.append(f"no contact at {contact.moment}: there are no points. Check threshold and views")
            self._create(0)
        if self._view == self.inputs.scene.views.contact:
            if self.inputs.scene.kind != "single_view":
                self.warnings.append('views.contact and views.topography are equal: is kind = "single_view" meant?')
            return
        frame = self._view.crop(read_frames(self.inputs.recording[[contact.reference_frame]]))[0]
        self.warnings += plausibility.check_clipped("topography", frame)
        if contact.skin is not None:
            compared = ridges.compare_views(contact.skin, frame, self._to_contact)
            self.warnings += plausibility.check_views(*compared, self.inputs.mm_per_px)

    def step(self, batch: Batch) -> Any:
        """Track all points through the frames of a batch, in order; unusable frames are skipped."""
        if "position" in self.results and not self.results["position"].shape[1]:
            return
        margin = batch.steps[ContactStage].density_margin
        images = batch.images(self.inputs, self._view)
        numbers, changes = np.arange(len(images)), np.flatnonzero(np.diff(self.usable[batch.indices])) + 1
        # New skin is searched, and windows are compared, where templates are checked.
        for run in np.split(numbers, np.union1d(changes, numbers[MOST_FRAMES::MOST_FRAMES])):
            indices = batch.indices[run]
            if self.usable[indices[0]]:
                self._step_through(images[run[0] : run[-1] + 1], indices, margin[run[0] : run[-1] + 1])
            elif self._seeded:
                self.results["status"][indices] = TrackStatus.FRAME_NOT_USABLE
                for points in self._seeded:
                    points.pass_over(len(indices))

    def _step_through(self, images: Images, indices: Numbers, margin: Array) -> None:
        groups: list[TrackedPoints] = []
        curved: list[Array] = []
        motion = _motion(self._seeded) if self._seeded else None
        for points, numbers in zip(self._seeded, self._around, strict=True):
            around = select(join(groups, 1), slice(None), numbers) if groups else None
            groups.append(points.follow(images, around))
            curved.append(points.curvature_variance(groups[-1], around))
        if not groups:
            groups.append(self._seed(images, margin[0, 0]))
            curved.append(self._seeded[0].curvature_variance(groups[0]))
        tracked_points = join(groups, 1)
        before = tracked_points.status.shape[1]
        new = self._seed_new(images, margin, tracked_points, motion)
        if new is not None:
            around = select(tracked_points, slice(None), self._around[-1])
            straight = np.zeros((len(images), new.status.shape[1]), np.float32)
            curved.append(self._seeded[-1].curvature_variance(new, around) if len(new.status) > 1 else straight)
            tracked_points = join([tracked_points, _extend_to_batch(len(images), new)], 1)
        pixels, error, status = tracked_points.points, tracked_points.error, tracked_points.status
        covered = covers(margin, tracked_points.estimate, self._matrix, self._engine.cell_px)
        seen = (status == TrackStatus.TRACKED) | (status == TrackStatus.WINDOW_DIFFERS)
        correlation = np.concatenate([group.correlation for group in self._seeded])
        self.results["position"][indices] = self.inputs.geometry.on_glass(pixels)
        self.results["position_px"][indices] = pixels
        self.results["position_std_px"][indices] = np.sqrt(tracked_points.variance + np.concatenate(curved, axis=1))
        self.results["position_noise_px"][indices] = np.sqrt(tracked_points.variance)
        self.results["subset_correlation"][indices] = np.where(seen, correlation, np.nan)
        self.results["forward_backward_error"][indices] = error
        self.results["status"][indices] = status
        self.results["in_contact"][indices] = covered & (status != TrackStatus.NOT_SEEDED_YET)
        if _CORRECTION in self.trial.requested:
            parts = [points.correction for points in self._seeded]  # 0 up to the frame in which a point was seeded
            parts = [np.pad(part, ((len(images) - len(part), 0), (0, 0), (0, 0))) for part in parts]
            self.results[_CORRECTION][indices] = np.where(np.isfinite(pixels), np.concatenate(parts, axis=1), np.nan)
        tracked = status[:, :before] == TrackStatus.TRACKED
        self.series["tracked_share"][indices] = tracked.mean(1)
        self.series["window_differs_share"][indices] = (status[:, :before] == TrackStatus.WINDOW_DIFFERS).mean(1)
        self._held[indices] = (status[:, :before] == TrackStatus.DUST_IN_WINDOW).mean(1)
        self.series["forward_backward_median"][indices] = nanmedian(np.where(tracked, error[:, :before], np.nan))

    def finish(self) -> None:
        self.warnings += plausibility.check_tracking(self.series["tracked_share"], self._held, self.first_frame)
        if self._seeded:  # templates of the previous frame are not there for points that are lost in the end
            by_key = self._settings.template == "keyframe"
            self.results["position_anisotropy"][:] = self._anisotropy() if by_key else 0.0

    def _anisotropy(self) -> Array:
        """Return xx - yy and 2 xy (N, 2) of the covariances of the positions on the glass, divided by xx + yy."""
        spread, onto = np.concatenate([points.spread for points in self._seeded]), self._matrix[:, :2]
        (xx, xy), (_, yy) = np.moveaxis(onto @ spread[:, (0, 1, 1, 2)].reshape(-1, 2, 2) @ onto.T, 0, -1)
        return np.nan_to_num(np.stack((xx - yy, 2 * xy), axis=1) / np.maximum(xx + yy, 1e-30)[:, None])

    def _create(self, points: int, noise: float = np.nan) -> None:
        for variable in TRACKING:
            if "point" in variable.dims and self.trial.stores(variable):
                about = {"image_noise": noise} if variable.name == "position_std_px" else None
                self.results.create(variable.name, about, point=points)
        for frame in np.flatnonzero(~self.usable):
            self.results["status"][[frame]] = TrackStatus.FRAME_NOT_USABLE

    def _seed(self, images: Images, margin: Array) -> TrackedPoints:
        """Seed the first points in the first of the n images, which is that of the first usable frame, and return their
        tracking results (n, N); `margin` is a grid of cells, positive in the gross contact of that frame.
        """
        image, where, requested = images[:1], self._seeding_region(margin), self._settings.points
        points = self._detect(image, where, requested)
        if len(points) < _FEWEST:
            # The frame with the largest contact may be later, and show it elsewhere than this frame.
            self._region = self.trial.stage(ContactStage).touched()
            where = self._seeding_region(margin)
            points = self._detect(image, where, requested)
        if len(points) < _FEWEST:
            raise FingerflowError(
                f"{self.inputs.recording.path}: {len(points)} points with texture were found in the "
                f"contact region of the topographic view, at least {_FEWEST} are needed. Check [views.topography] and "
                f"its region, [stream] region, tracking.min_distance_px, the calibration and the focus."
            )
        self.warnings += plausibility.check_points(len(points), requested, self._settings.min_distance_px, where.sum())
        self.warnings += plausibility.check_seeded_region(self._outside(where, margin))
        self.warnings += plausibility.check_impulses(self._impulses(image))
        self._create(len(points), noise_of(self._engine, image))
        self._density = len(points) / float(where.sum())
        self._new_skin.begin(where, margin, points)
        return self._start_tracking(images, points, None, np.zeros(0, np.intp))

    def _impulses(self, image: Images) -> float:
        """Return the share of the pixels of a frame that differ from the median of the 3 x 3 pixels around by more than
        texture or noise can cause (impulse noise).
        """
        pixels = np.asarray(image, dtype=np.float32)[0, 0]
        least = max(_IMPULSE * np.ptp(pixels), _BEYOND_NOISE * noise_of(self._engine, image))
        return (np.abs(pixels - cv2.medianBlur(pixels, 3)) > least).mean()

    def _start_tracking(
        self, images: Images, points: Array, others: TrackedPoints | None, near: Numbers, *more: Any
    ) -> TrackedPoints:
        """Track newly seeded points (N, 2) px from the first of the n images on, and return their results (n, N).

        `others` are the results of earlier points in these images, `near` the indices of those near the new ones;
        `more` are the positions of these in the first image, and the motion of the new ones.
        """
        template, knowledge = self._settings.template, self.inputs.knowledge
        new = Points(self._engine, images[:1], points, *more, template=template, knowledge=knowledge)
        self._seeded.append(new)
        self._around.append(near)
        rest = [new.follow(images[1:], others and select(others, slice(1, None), near))] if len(images) > 1 else []
        return join([new.as_seeded, *rest], 0)

    def _detect(self, image: Images, where: Mask, count: int) -> Array:
        picture = image if self._settings.points_from == "recorded" else self._enhanced(image)
        return self._engine.detect(picture, where, count)

    def _seed_new(
        self, images: Images, margin: Array, tracked_points: TrackedPoints, motion: PointMotion | None
    ) -> TrackedPoints | None:
        """Seed points in skin that has none yet, and return their tracking results (n or 1, K); None without such skin.

        They are seeded in the last of the n images, or in the first where most of the skin has touched since.
        `tracked_points` (n, N) are the tracking results of the earlier points, `motion` is theirs before the first
        image.
        """
        if self._full:
            return None
        position = np.concatenate([group.expect(0) for group in self._seeded])
        start = np.concatenate([group.start for group in self._seeded])
        total, tracked = len(position), tracked_points.status[-1] == TrackStatus.TRACKED
        seeding = np.repeat(np.arange(len(self._seeded)), [len(group) for group in self._seeded])
        region = self._new_skin.region(margin[-1, 0], position, position - start, tracked, seeding)
        if region is None:
            return None
        moved = np.nan_to_num(nanmedian((tracked_points.points[-1] - tracked_points.points[0]).T))
        touching = region & self._touching(margin[-1, 0])
        came = (touching & ~_shifted(self._touching(margin[0, 0]), moved)).sum()
        if tracked.mean() >= LEFT and came > max(touching.sum() / 2, self._settings.window_px**2):
            begin, region, motion = 0, _shifted(region, -moved), motion or PointMotion.at_rest(start)
        else:
            begin, motion = len(images) - 1, _motion(self._seeded)
        if (drawn := region_mask(self.inputs.scene, "topography")) is not None:
            region &= drawn
        count = min(round(self._density * region.sum()), MOST_SEEDED * self._settings.points - total)
        if count < 1:
            return None
        points = self._detect(images[begin : begin + 1], region, count)
        if not len(points) or not self._make_room(total, len(points)):
            return None
        around = tracked_points.points[begin]
        distance, _ = cKDTree(points).query(np.where(np.isfinite(around), around, position))
        near = np.flatnonzero(tracked & np.isfinite(around).all(1) & (distance <= WARP_GAUGE_PX))
        self._new_skin.searched.append(region)
        others, motion_of_new = select(tracked_points, slice(begin, None)), motion.seeded(points)
        return self._start_tracking(images[begin:], points, others, near, around[near], motion_of_new)

    def _make_room(self, points: int, more: int) -> bool:
        """Extend the result arrays of `points` points by `more` points; return False, with a warning, if there is no
        room for the results.
        """
        variables = filter(self.trial.stores, (variable for stage in self.trial.planned for variable in stage.gives))
        most = f"{points + more} points, {MOST_SEEDED} times tracking.points, have been seeded"
        why = most if points + more == MOST_SEEDED * self._settings.points else ""
        try:
            self.results.check_room(size_of_results(variables, len(self.trial), more))
        except NoRoomError as error:
            why, more = str(error), 0
        if why:
            self._full = True
            self.warnings.append(f"no more points are seeded where skin comes into contact: {why}")
        if more:
            self.results.grow(points + more, {"status": TrackStatus.NOT_SEEDED_YET})
        return more > 0

    def _enhanced(self, image: Images) -> Images:
        """Return an image with enhanced contrast for the seeding of points (Willemet et al., 2021, figure S3 B).

        It makes little difference: on the shipped press, points seeded in it are 0.0274 px off in the last frame,
        others 0.0282, and as many lie on dust.
        """
        # Import here, since loading kornia takes a third of a second.
        from fingerflow.ops.tracking.contrast import stretch_contrast, subtract_background, unsharp_mask

        recorded = torch.as_tensor(np.asarray(image, dtype=np.float32)).to(self.inputs.device)
        skin = subtract_background(recorded, self.inputs.reference(self._view))
        return self._engine.images(unsharp_mask(stretch_contrast(skin), _SHARPEN_PX)[:, 0].cpu().numpy())

    def _seeding_region(self, margin: Array) -> Mask:
        """Return the mask (h, w) of the topographic view in which the first points are seeded.

        That is the region which the scene defines in the topographic view. Otherwise, for forward tracking, it is
        `stream.region`, so that a stream seeds the same points. Otherwise it is the contact region found by `begin`, or
        where a contact that begins later, by the cells `margin`, and moves comes to lie.
        """
        drawn = region_mask(self.inputs.scene, "topography")
        if drawn is not None:
            return drawn
        stated = self.inputs.scene.stream.region
        if stated is not None and self._settings.direction == "forward":
            mask = np.zeros(self._view.shape, dtype=bool)
            stated.crop(mask)[...] = True
            return mask
        contact = self.trial.stage(ContactStage)
        # Medians are NaN where less than `LEAST_SHARE` is known.
        most = (1 - LEAST_SHARE) * self._region.sum()
        if not (margin > 0).any() and (contact.touched(_FEW) & ~self._region).sum() > most:
            self._region = contact.touched()
        return self._on_topography(self._region)

    def _on_topography(self, region: Mask) -> Mask:
        return on_topography(region, self._to_contact, self._view.shape)

    def _touching(self, margin: Array) -> Mask:
        """Return the mask (h, w) of the topographic view of the cells that are positive in `margin`."""
        (rows, columns), cell = self._region.shape, self._engine.cell_px
        return self._on_topography((margin > 0).repeat(cell, 0).repeat(cell, 1)[:rows, :columns])

    def _outside(self, seeded: Mask, margin: Array) -> float:
        """Return the share of the contact further than two windows from the region `seeded` (h, w): of the contact in
        the first frame, by the cells `margin` that are positive there, or of the largest if there is none yet.
        """
        reach = 4 * self._settings.window_px + 1
        contact = self._touching(margin) if (margin > 0).any() else self._on_topography(self._region)
        near = cv2.dilate(seeded.astype(np.uint8), np.ones((reach, reach)))
        return (contact & (near == 0)).sum() / max(contact.sum(), 1)


def _motion(groups: list[Points]) -> PointMotion:
    """Return the motion of the points of all groups."""
    return PointMotion(*map(np.concatenate, zip(*(group.motion for group in groups), strict=True)))


def _shifted(mask: Mask, way: Array) -> Mask:
    """Return a mask (h, w) shifted by (x, y) px."""
    matrix = np.column_stack((np.eye(2), way))
    return cv2.warpAffine(mask.astype(np.uint8), matrix, mask.shape[::-1], flags=cv2.INTER_NEAREST) > 0


def _extend_to_batch(frames: int, seeded: TrackedPoints) -> TrackedPoints:
    """Extend results (n, N) of points seeded in one of the `frames` frames of a batch to the whole batch; NaN in
    earlier frames.
    """
    missing = frames - len(seeded.status)
    whole = select(seeded, np.maximum(np.arange(frames) - missing, 0))
    for values in whole[:3]:
        values[:missing] = np.nan
    whole.status[:missing] = TrackStatus.NOT_SEEDED_YET
    return whole
