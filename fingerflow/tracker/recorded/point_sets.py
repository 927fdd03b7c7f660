"""Points of a recording, in sets: those seeded at first, and those seeded later where skin without points touches."""

from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
from scipy.spatial import cKDTree

from fingerflow.engines.engine import TRACKED, Engine, Images, TrackedPoints, select
from fingerflow.kernels.array_types import Array, Mask, Numbers
from fingerflow.kernels.arrays import nanmedian
from fingerflow.kernels.tracking_limits import WARP_GAUGE_PX, TrackStatus
from fingerflow.recordings.lens import Geometry
from fingerflow.tracker.point_prediction import PointMotion
from fingerflow.tracker.points import Knowledge, Points, join
from fingerflow.tracker.recorded.new_skin import LEFT, NewSkin, touching_skin


class NewSeeding(NamedTuple):
    """Seeding that is due in one of the frames tracked last: index of this frame among them, region (h, w) of the
    topographic view, and motion of the earlier points up to this frame.
    """

    frame: int
    region: Mask
    motion: PointMotion


class PointSets:
    """Tracker of the points of a recording, in sets of points that share a key frame, that of their seeding.

    Earlier points near a new set are tracked with it (`Points`, surrounding points).

    Args:
        engine: that computes.
        geometry: of the views.
        template: "keyframe" or "previous", as for `Points`.
        knowledge: what tracking may use of later frames.
    """

    def __init__(self, engine: Engine, geometry: Geometry, template: str, knowledge: Knowledge) -> None:
        self._engine, self._geometry = engine, geometry
        self._prepare = partial(Points, engine, template=template, knowledge=knowledge)
        self._new_skin = NewSkin(geometry, engine.cell_px, engine.settings.window_px)
        self._sets: list[Points] = []
        self._around: list[Numbers] = []  # for each set: indices (A,) of its surrounding points
        self._curved: list[Array] = []  # for each set: variances in the frames tracked last
        self._before: PointMotion | None = None  # motion before these frames; None if the first points came in them

    def __len__(self) -> int:
        return sum(map(len, self._sets))

    @property
    def curvature_variance(self) -> Array:
        """Return the variances (n, N) px^2 of the positions of all points in the n frames tracked last by displacement
        that is curved within windows, and by things on the glass.
        """
        return np.concatenate(self._curved, axis=1)

    @property
    def correlation(self) -> Array:
        """Return the correlation coefficients (N,) of all points (`Points.correlation`)."""
        return np.concatenate([points.correlation for points in self._sets])

    def correction(self, frames: int) -> Array:
        """Return the corrections (n, N, 2) px of all points (`Points.correction`) in the n = `frames` frames tracked
        last; 0 up to the frame in which a point was seeded.
        """
        parts = [points.correction for points in self._sets]
        return np.concatenate([np.pad(part, ((frames - len(part), 0), (0, 0), (0, 0))) for part in parts], axis=1)

    def anisotropy(self) -> Array:
        """Return xx - yy and 2 xy (N, 2) of the covariances of the positions on the glass, divided by xx + yy."""
        spread = np.concatenate([points.spread for points in self._sets])
        onto = self._geometry.topography_to_contact.astype(np.float32)[:, :2]
        (xx, xy), (_, yy) = np.moveaxis(onto @ spread[:, (0, 1, 1, 2)].reshape(-1, 2, 2) @ onto.T, 0, -1)
        return np.nan_to_num(np.stack((xx - yy, 2 * xy), axis=1) / np.maximum(xx + yy, 1e-30)[:, None])

    def pass_over(self, frames: int) -> None:
        """Skip `frames` frames in which points are not tracked."""
        for points in self._sets:
            points.pass_over(frames)

    def seed(self, images: Images, points: Array, region: Mask, margin: Array) -> TrackedPoints:
        """Track the first points (N, 2) px, which were detected in a `region` (h, w) of the first of n images, through
        all of them, and return the results (n, N); `margin` (h', w') is positive in the cells that touch then.
        """
        self._new_skin.begin(region, margin, points)
        tracked = self._track(self._prepare(images[:1], points), np.zeros(0, np.intp), images)
        self._curved = [self._sets[0].curvature_variance(tracked)]
        return tracked

    def follow(self, images: Images) -> TrackedPoints:
        """Track all points through the next n images (n, 1, h, w), and return the results (n, N)."""
        self._before, self._curved = self._motion(), []
        groups: list[TrackedPoints] = []
        for points, numbers in zip(self._sets, self._around, strict=True):
            around = select(join(groups, 1), slice(None), numbers) if groups else None
            groups.append(points.follow(images, around))
            self._curved.append(points.curvature_variance(groups[-1], around))
        return join(groups, 1)

    def due_seeding(self, margin: Array, tracked: TrackedPoints) -> NewSeeding | None:
        """Return the seeding that is due in the n frames tracked last, as skin without points touches there or is about
        to; None if none is. It is due in the last frame, or in the first if most of this skin has touched since.

        `margin` (n, 1, h', w') is positive in the cells of the contact, `tracked` (n, N) are the results of all points.
        """
        position, start = self._expected(), np.concatenate([points.start for points in self._sets])
        is_tracked = tracked.status[-1] == TRACKED
        seeding = np.repeat(np.arange(len(self._sets)), [len(points) for points in self._sets])
        region = self._new_skin.region(margin[-1, 0], position, position - start, is_tracked, seeding)
        if region is None:
            return None
        moved = np.nan_to_num(nanmedian((tracked.points[-1] - tracked.points[0]).T))
        first, last = (touching_skin(margin[k, 0], self._engine.cell_px, self._geometry) for k in (0, -1))
        touching = region & last
        came = (touching & ~_shifted(first, moved)).sum()
        if is_tracked.mean() >= LEFT and came > max(touching.sum() / 2, self._engine.settings.window_px**2):
            return NewSeeding(0, _shifted(region, -moved), self._before or PointMotion.at_rest(start))
        return NewSeeding(len(margin) - 1, region, self._motion())

    def add(self, images: Images, points: Array, new: NewSeeding, tracked: TrackedPoints) -> TrackedPoints:
        """Track a new set of points (K, 2) px, which were detected for the seeding `new`, through the rest of the n
        images tracked last, and return the results (n, N + K) of all points, from those of the earlier ones (n, N).

        In frames before the seeding the new points have the status NOT_SEEDED_YET.
        """
        around = tracked.points[new.frame]
        known = np.isfinite(around)
        distance, _ = cKDTree(points).query(np.where(known, around, self._expected()))
        near = np.flatnonzero((tracked.status[-1] == TRACKED) & known.all(1) & (distance <= WARP_GAUGE_PX))
        self._new_skin.searched.append(new.region)
        neighbours, rest = select(tracked, slice(None), near), images[new.frame :]
        added = self._prepare(rest[:1], points, around[near], new.motion.seeded(points))
        here = self._track(added, near, rest, select(neighbours, slice(new.frame, None)))
        if len(rest) > 1:
            self._curved.append(added.curvature_variance(here, neighbours))
        else:
            self._curved.append(np.zeros((len(images), len(points)), np.float32))
        return join([tracked, _extend_to_batch(len(images), here)], 1)

    def _track(
        self, points: Points, near: Numbers, images: Images, neighbours: TrackedPoints | None = None
    ) -> TrackedPoints:
        """Add a set of points, track it from the first of n images, its key frame, and return the results (n, N).

        `near` are the indices (A,) of the surrounding points, `neighbours` (n, A) their results.
        """
        self._sets.append(points)
        self._around.append(near)
        if len(images) == 1:
            return points.as_seeded
        later = points.follow(images[1:], neighbours and select(neighbours, slice(1, None)))
        return join([points.as_seeded, later], 0)

    def _expected(self) -> Array:
        """Return the positions (N, 2) px of all points in the last frame, measured or expected."""
        return np.concatenate([points.expect(0) for points in self._sets])

    def _motion(self) -> PointMotion:
        return PointMotion(*map(np.concatenate, zip(*(points.motion for points in self._sets), strict=True)))


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
