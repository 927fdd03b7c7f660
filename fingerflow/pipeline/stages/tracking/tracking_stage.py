"""Tracking of skin points through all frames, in the topographic view."""

from typing import Any, ClassVar

import cv2
import numpy as np
import torch

from fingerflow.engines.contact_view import covers
from fingerflow.engines.engine import Images, TrackedPoints, noise_of
from fingerflow.errors import FingerflowError, NoRoomError
from fingerflow.kernels.array_types import Array, Mask, Numbers
from fingerflow.kernels.arrays import nanmedian
from fingerflow.kernels.field_limits import LEAST_SHARE
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.pipeline.stages.contact.contact_stage import ContactStage
from fingerflow.pipeline.stages.preparation import plausibility, ridges
from fingerflow.pipeline.stages.preparation.frame_check import FrameCheckStage
from fingerflow.pipeline.stages.preparation.inputs import SCALE_KEYS, read_frames, region_mask
from fingerflow.pipeline.stages.stage import Batch, RunContext, Stage
from fingerflow.results.free_space import size_of_results
from fingerflow.schema.variables import TRACKING
from fingerflow.tracker.points import MOST_FRAMES
from fingerflow.tracker.recorded.new_skin import on_topography, touching_skin
from fingerflow.tracker.recorded.point_sets import PointSets

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
        self._points = PointSets(self._engine, inputs.geometry, self._settings.template, inputs.knowledge)
        self._full = False  # True if no more points may be seeded
        self._held = np.full(len(trial), np.nan)

    def begin(self) -> None:
        """Find the contact region in which points are to be seeded, and warn if no contact is found."""
        contact = self.trial.stage(ContactStage)
        self._region = contact.seeding_region(self._settings.window_px)  # (h, w) px of the contact view
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
            compared = ridges.compare_views(contact.skin, frame, self.inputs.geometry.topography_to_contact)
            self.warnings += plausibility.check_views(*compared, self.inputs.mm_per_px)

    def step(self, batch: Batch) -> Any:
        """Track all points through the frames of a batch, in order; unusable frames are skipped."""
        if "position" in self.results and not self.results["position"].shape[1]:
            return
        margin = batch.steps[ContactStage].density_margin
        images = self._engine.images(self.inputs.counts(batch.frames, self._view))
        numbers, changes = np.arange(len(images)), np.flatnonzero(np.diff(self.usable[batch.indices])) + 1
        # New skin is searched, and windows are compared, where templates are checked.
        for run in np.split(numbers, np.union1d(changes, numbers[MOST_FRAMES::MOST_FRAMES])):
            indices = batch.indices[run]
            if self.usable[indices[0]]:
                self._step_through(images[run[0] : run[-1] + 1], indices, margin[run[0] : run[-1] + 1])
            elif len(self._points):
                self.results["status"][indices] = TrackStatus.FRAME_NOT_USABLE
                self._points.pass_over(len(indices))

    def _step_through(self, images: Images, indices: Numbers, margin: Array) -> None:
        points = self._points
        tracked_points = points.follow(images) if len(points) else self._seed(images, margin[0, 0])
        before = tracked_points.status.shape[1]
        tracked_points = self._seed_new(images, margin, tracked_points)
        pixels, error, status = tracked_points.points, tracked_points.error, tracked_points.status
        to_contact = self.inputs.geometry.topography_to_contact
        covered = covers(margin, tracked_points.estimate, to_contact, self._engine.cell_px)
        seen = (status == TrackStatus.TRACKED) | (status == TrackStatus.WINDOW_DIFFERS)
        self.results["position"][indices] = self.inputs.geometry.on_glass(pixels)
        self.results["position_px"][indices] = pixels
        self.results["position_std_px"][indices] = np.sqrt(tracked_points.variance + points.curvature_variance)
        self.results["position_noise_px"][indices] = np.sqrt(tracked_points.variance)
        self.results["subset_correlation"][indices] = np.where(seen, points.correlation, np.nan)
        self.results["forward_backward_error"][indices] = error
        self.results["status"][indices] = status
        self.results["in_contact"][indices] = covered & (status != TrackStatus.NOT_SEEDED_YET)
        if _CORRECTION in self.trial.requested:
            correction = points.correction(len(images))
            self.results[_CORRECTION][indices] = np.where(np.isfinite(pixels), correction, np.nan)
        tracked = status[:, :before] == TrackStatus.TRACKED
        self.series["tracked_share"][indices] = tracked.mean(1)
        self.series["window_differs_share"][indices] = (status[:, :before] == TrackStatus.WINDOW_DIFFERS).mean(1)
        self._held[indices] = (status[:, :before] == TrackStatus.DUST_IN_WINDOW).mean(1)
        self.series["forward_backward_median"][indices] = nanmedian(np.where(tracked, error[:, :before], np.nan))

    def finish(self) -> None:
        self.warnings += plausibility.check_tracking(self.series["tracked_share"], self._held, self.first_frame)
        if len(self._points):  # templates of the previous frame are not there for points that are lost in the end
            by_key = self._settings.template == "keyframe"
            self.results["position_anisotropy"][:] = self._points.anisotropy() if by_key else 0.0

    def _create(self, points: int, noise: float = np.nan) -> None:
        for variable in self.stored:
            if "point" in variable.dims:
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
        self._density = len(points) / float(where.sum())  # points per px
        return self._points.seed(images, points, where, margin)

    def _impulses(self, image: Images) -> float:
        """Return the share of the pixels of a frame that differ from the median of the 3 x 3 pixels around by more than
        texture or noise can cause (impulse noise).
        """
        pixels = np.asarray(image, dtype=np.float32)[0, 0]
        least = max(_IMPULSE * np.ptp(pixels), _BEYOND_NOISE * noise_of(self._engine, image))
        return (np.abs(pixels - cv2.medianBlur(pixels, 3)) > least).mean()

    def _detect(self, image: Images, where: Mask, count: int) -> Array:
        picture = image if self._settings.points_from == "recorded" else self._enhanced(image)
        return self._engine.detect(picture, where, count)

    def _seed_new(self, images: Images, margin: Array, tracked: TrackedPoints) -> TrackedPoints:
        """Seed points in skin that has none yet, and return the results (n, N + K) of all points, given those of the
        earlier points, `tracked` (n, N).
        """
        new = None if self._full else self._points.due_seeding(margin, tracked)
        if new is None:
            return tracked
        if (drawn := region_mask(self.inputs.scene, "topography")) is not None:
            new = new._replace(region=new.region & drawn)
        total = len(self._points)
        count = min(round(self._density * new.region.sum()), MOST_SEEDED * self._settings.points - total)
        if count < 1:
            return tracked
        points = self._detect(images[new.frame :][:1], new.region, count)
        if not len(points) or not self._make_room(total, len(points)):
            return tracked
        return self._points.add(images, points, new, tracked)

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
        return on_topography(self._region, self.inputs.geometry)

    def _outside(self, seeded: Mask, margin: Array) -> float:
        """Return the share of the contact further than two windows from the region `seeded` (h, w): of the contact in
        the first frame, by the cells `margin` that are positive there, or of the largest if there is none yet.
        """
        reach = 4 * self._settings.window_px + 1
        geometry = self.inputs.geometry
        if (margin > 0).any():
            contact = touching_skin(margin, self._engine.cell_px, geometry)
        else:
            contact = on_topography(self._region, geometry)
        near = cv2.dilate(seeded.astype(np.uint8), np.ones((reach, reach)))
        return (contact & (near == 0)).sum() / max(contact.sum(), 1)
