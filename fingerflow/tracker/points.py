"""Tracking of points through the frames after the key frame in which the points were seeded."""

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from fingerflow.engines.engine import (
    ROWS,
    TRACKED,
    Corrected,
    Engine,
    Followed,
    FrameContact,
    FrameFields,
    Images,
    TemplateBuffers,
    TrackedPoints,
    reject,
    select,
)
from fingerflow.kernels.array_types import Array
from fingerflow.kernels.arrays import identities, inverse_2x2, is_finite
from fingerflow.kernels.tracking_limits import UPDATE_PX, Number, TrackStatus
from fingerflow.tracker.deviations.curvature import Curvature
from fingerflow.tracker.point_prediction import TRUSTED, PointMotion
from fingerflow.tracker.recovery import Search, Track, lost_points, recover, replaced
from fingerflow.tracker.subset_verification import Verification

Record = TypeVar("Record", FrameContact, FrameFields, TrackedPoints)

_MOST_VARIANCE = 1.0  # px^2, of a position, above which it is not located
MOST_FRAMES = 8  # longest update interval of templates, for slow skin
FASTEST_PX = 0.2  # by which the edges of windows may shift within an interval


@dataclass(frozen=True)
class Knowledge:
    """Tracking conditions of a recording or a stream: whether later frames are known, and limits of computing time.

    Attributes:
        ahead: True if later frames are known. Several frames may then be tracked in one call, and a point that fails
            the verification is rejected in all frames since the check before.
        searched: largest number of points searched for in one round of a frame; None for all.
        patience: frames for which a lost point is searched for.
    """

    ahead: bool = True
    searched: int | None = None
    patience: float = math.inf


RECORDING = Knowledge()
STREAM = Knowledge(ahead=False, searched=ROWS, patience=TRUSTED)


class _Pending(NamedTuple):
    """Pending update of the templates with indices `rows` (L,), which is to be carried out before frame number `due` is
    tracked.

    `warp` (L, 2, 2) is the deformation of the new templates.
    """

    due: int
    rows: Array
    warp: Array
    prepared: list[TemplateBuffers]  # templates of the first rows, prepared in pieces ahead of time


class Points:
    """Tracker of N points from the key frame in which they were seeded: holds templates, motion and deformation.

    The deformation of the skin around them is fitted to them and to A points that were seeded before and are known in
    the key frame too: points in a narrow band alone would not determine it.

    With template "keyframe" every frame is compared with the key frame, the template deformed by the gradient of the
    motion found so far, and errors do not add up. With "previous" every frame is compared with the one before, and
    errors add up.

    Attributes:
        motion: position and speed of the points.
        start: (N, 2) px, reference positions in the key frame.
        pull: (n, N) px^2, variance of the positions of the last `follow` by things on the glass; at first 0.
    """

    def __init__(
        self, engine: Engine, image: Images, points: Array, around: Array | None = None,
        motion: PointMotion | None = None, *, template: str = "keyframe", knowledge: Knowledge = RECORDING,
    ) -> None:  # fmt: skip
        """Prepare the templates of `points` (N, 2) px in the key frame `image` (1, 1, h, w).

        `around` (A, 2) px are the surrounding points in it; NaN stands for no point. By default the points are at rest
        (`motion`).
        """
        self._engine, self._knowledge, self._by_key = engine, knowledge, template == "keyframe"
        points = np.ascontiguousarray(points, np.float32)
        around = np.zeros((0, 2), np.float32) if around is None else around
        self._every = np.concatenate((points, around)).astype(np.float32)
        self.motion = motion or PointMotion.at_rest(points)
        self._verification, self._curvature = Verification(engine, image, points), Curvature(engine, self._every)
        self.pull = np.zeros((1, len(points)), np.float32)
        unchanged = identities(len(points))
        # Deformation gradient at the last check, and the inverse of that in the templates.
        self._warp, self._inverse_warp = unchanged, unchanged.copy()
        self._steps: list[Corrected] = []  # of the frames of the last `follow`
        self._interval = MOST_FRAMES if self._by_key else 1  # frames to the next check of templates
        self._pending: list[_Pending] = []
        self._preparing = threading.Lock()
        # Frames tracked since the key frame, those at the last check of templates, and frames skipped since the last.
        self._followed = self._checked = 1
        self._gap = 0
        self._walked: Array | float = 0.0  # variance accumulated from frame to frame
        self._templates = engine.prepare(image, points)

    @property
    def start(self) -> Array:
        """Return the reference positions (N, 2) px of the points in the key frame."""
        return self._every[: len(self)]

    @property
    def spread(self) -> Array:
        """Return the covariances xx, xy and yy (N, 3) px^2 of the positions for noise of variance 1 in the pixels."""
        return self._templates.numbers[:, Number.COVARIANCE_XX : Number.COVARIANCE_YY + 1]

    @property
    def correlation(self) -> Array:
        """Return the correlation coefficient (N,) between the window around each point and its window in the key frame,
        as of the last verification.
        """
        return self._verification.correlation

    def __len__(self) -> int:
        return len(self.motion.position)

    @property
    def as_seeded(self) -> TrackedPoints:
        """Return the tracking result (1, N) for the key frame itself, with all points at the seeded positions."""
        points = self.start[None]
        status = np.where(is_finite(points), TRACKED, TrackStatus.NOT_FINITE).astype(np.uint8)
        unknown = np.where(is_finite(points), np.float32(0), np.float32(np.nan))
        covariance = np.repeat(unknown, 4).reshape(*points.shape, 2)
        return TrackedPoints(points.copy(), unknown, covariance, status, points.copy())

    def pass_over(self, frames: int) -> None:
        """Skip `frames` frames in which points are not tracked; later predictions extrapolate over these frames."""
        self._gap += frames

    def expect(self, ahead: int = 1) -> Array:
        """Predict the positions (N, 2) px of the points, `ahead` frames after the last frame tracked or skipped."""
        return self.motion.expect(self._gap + ahead)

    def follow(self, images: Images, around: TrackedPoints | None = None) -> TrackedPoints:
        """Track the N points through the next n images (n, 1, h, w), and return the result (n, N).

        `around` (n, A) is the result of the surrounding points. Estimates are the last known positions.
        """
        steps: list[TrackedPoints] = []
        done, self._steps, self.pull = 0, [], self.pull[:0]
        while done < len(images):
            until_check = MOST_FRAMES - self._followed % MOST_FRAMES
            count = min(self._interval, until_check, len(images) - done) if self._knowledge.ahead else 1
            now = slice(done, done + count)
            step = self._step(images[now], around and select(around, now))
            steps.append(step if self._knowledge.ahead else self._verified(images[now], step))
            done += count
        joined = join(steps, 0)
        return self._verified(images, joined) if self._knowledge.ahead else joined

    @property
    def correction(self) -> Array:
        """Return for each frame of the last `follow`, at first the key frame, the positions (n, N, 2) px at which the
        templates were registered, less the positions corrected for the deformation of the skin.
        """
        parts = [step.found.estimate - step.found.points for step in self._steps]
        return np.concatenate(parts) if parts else np.zeros((1, *self.start.shape), np.float32)

    def curvature_variance(self, tracked: TrackedPoints, around: TrackedPoints | None = None) -> NDArray[np.float32]:
        """Return the variance (n, N) px^2 of the positions `tracked` (n, N) in the next n frames by displacement since
        the key frame that is curved within windows, and by `pull`; `around` (n, A) is the result of the surrounding
        points.
        """
        positions = tracked.points if around is None else np.concatenate((tracked.points, around.points), axis=1)
        variance = self._curvature.update(positions)[:, : len(self)]
        variance[-len(self.pull) :] += self.pull
        return variance

    def _update_templates(self) -> None:
        """Carry out the template updates that are due, in the order in which they were planned."""
        while self._pending and self._pending[0].due <= self._followed:
            with self._preparing:
                pending = self._pending.pop(0)
                self._prepare_rows(pending, len(pending.rows))
            done = 0
            for piece in pending.prepared:
                rows = pending.rows[done : done + len(piece.numbers)]
                self._templates.update(rows, piece)
                done += len(rows)
            self._inverse_warp[pending.rows] = inverse_2x2(pending.warp)

    def prepare_ahead(self) -> None:
        """Prepare part of the templates of the next planned update, so that no frame waits for all of them.

        Any thread may call it while others track frames. A part is always a multiple of `ROWS`: sums of an exported
        graph differ in the last digit by a row's place in a call, and timing must not change results.
        """
        with self._preparing:
            for pending in self._pending[:1]:
                self._prepare_rows(pending, ROWS * -(-len(pending.rows) // (ROWS * (MOST_FRAMES - 1))))

    def _prepare_rows(self, pending: _Pending, rows: int) -> None:
        """Prepare up to `rows` more of the templates that a pending update will replace."""
        done = sum([len(piece.numbers) for piece in pending.prepared])
        part = slice(done, done + rows)
        if done < len(pending.rows):
            start = self.start[pending.rows[part]]
            pending.prepared.append(self._engine.prepare(self._templates, start, pending.warp[part]))

    def _step(self, images: Images, around: TrackedPoints | None) -> TrackedPoints:
        self._update_templates()
        guess = self.expect()
        if len(images) == 1:
            tracked = self._engine.track(self._templates, images, guess, np.zeros(guess.shape, np.float32)).found
            tracked, jolted = self._recovered(images, guess, tracked)
            before, corrected = self.motion, self._corrected(tracked, around)
            self.motion = before.update(corrected.found.points[0], self._gap + 1, corrected.expected[0], jolted)
            return self._checked_templates(corrected, before.position, 1, images)
        speed = self.motion.speed
        return self._finish_images(images, self._engine.track(self._templates, images, guess - speed, speed), around)

    def _track_image(self, image: Images, guess: Array, rows: Array) -> TrackedPoints:
        """Track the points with indices `rows` in one image near guessed positions."""
        guess = guess.astype(np.float32, copy=False)
        return self._engine.track(self._templates, image, guess, np.zeros(guess.shape, np.float32), rows).found

    def _finish_images(self, images: Images, followed: Followed, around: TrackedPoints | None) -> TrackedPoints:
        """Finish several images tracked in one call: recover lost points, correct positions for the deformation of the
        skin, update the motion, and return the tracked points.
        """
        lost = lost_points(followed.found.status).any(0)
        if self._engine.settings.search_px and lost.any():
            followed = self._recover_all(images, followed, np.flatnonzero(lost))
        before, frames = self.motion, self._gap + len(images)
        corrected = self._corrected(followed.found, around)
        last, expected = corrected.found.points[-1], corrected.expected[-1]
        self.motion = before.followed(followed.place, followed.speed, last, frames, expected)
        return self._checked_templates(corrected, before.position, len(images))

    def _recover_all(self, images: Images, followed: Followed, rows: Array) -> Followed:
        """Recover points, with indices `rows`, that were lost in any of several images: track them again image by
        image, and search for them where tracking fails.
        """
        motion, frames, gap = PointMotion(*(values[rows] for values in self.motion)), [], self._gap
        for k in range(len(images)):
            image = images[k : k + 1]
            guess = motion.expect(gap + 1)
            tracked = self._track_image(image, guess, rows)
            track, search = self._track_and_search(image, rows)
            tracked, searched = recover(tracked, guess, np.ones(len(rows), dtype=bool), track, search)
            motion = motion.update(tracked.points[0], gap + 1, jolted=searched)
            frames.append(tracked)
            gap = 0
        tracked = replaced(followed.found, rows, join(frames, 0))
        position, speed = followed.place.copy(), followed.speed.copy()
        position[rows], speed[rows] = motion.position, motion.speed
        return Followed(tracked, position, speed)

    def _track_and_search(self, image: Images, rows: Array) -> tuple[Track, Search]:
        """Return two functions for `recover`: one tracks the points `rows` in an image, the other searches for them.

        They number these points from 0.
        """

        def track(positions: Array, numbers: Array) -> TrackedPoints:
            return self._track_image(image, positions, rows[numbers])

        def search(numbers: Array, guess: Array) -> tuple[Array, Array]:
            return self._engine.search(self._templates, image, self.start[rows[numbers]], guess)

        return track, search

    def _recovered(self, image: Images, guess: Array, tracked: TrackedPoints) -> tuple[TrackedPoints, Array | None]:
        """Recover the lost points of a frame by tracking them again and by searching for them.

        Return the result, and the points (N,) that were searched for (None if none).
        """
        searchable = self.motion.missing < self._knowledge.patience
        lost = lost_points(tracked.status[0]) & searchable
        if not (self._engine.settings.search_px and np.logical_or.reduce(lost)):
            return tracked, None
        track, search = self._track_and_search(image, np.arange(len(self)))
        limits = self._knowledge.searched, lambda found: self._corrected(found).expected[0]
        return recover(tracked, guess, searchable, track, search, *limits)

    def _corrected(self, tracked: TrackedPoints, around: TrackedPoints | None = None) -> Corrected:
        """Mark outliers among the tracked points, and correct all positions for the deformation of the skin.

        With template "previous" the points are returned unchanged.
        """
        if not self._by_key:
            unchanged = identities(*tracked.status.shape)
            nothing = np.zeros(tracked.status.shape, np.float32)
            return Corrected(tracked, unchanged, nothing, np.full_like(tracked.points, np.nan))
        extra = 0 if around is None else around.status.shape[1]
        together = tracked if around is None else join([tracked, around], 1)
        corrected = self._engine.correct(self._every, together, *self._template_data(extra))
        if extra:
            seeded = slice(len(self))
            found = select(corrected.found, slice(None), seeded)
            corrected = Corrected(found, *(values[:, seeded] for values in corrected[1:]))
        found = corrected.found
        # Few neighbours give a deformation so uncertain that it puts the point many px off.
        certain = reject(found, (found.status == TRACKED) & (found.variance > _MOST_VARIANCE), TrackStatus.UNCERTAIN)
        return corrected if certain is found else Corrected(certain, *corrected[1:])

    def _template_data(self, surrounding: int) -> tuple[Array, Array]:
        """Return the statistics and the inverse deformation gradients (2 x 2) of the templates of all points, followed
        by default values for `surrounding` surrounding points, which have no templates.

        Those of the A surrounding points are zero but for COVARIANCE_XX = 1, and the identity.
        """
        numbers = self._templates.numbers
        if not surrounding:
            return numbers, self._inverse_warp
        none = np.zeros((surrounding, numbers.shape[1]), np.float32)
        none[:, Number.COVARIANCE_XX] = 1.0
        return np.concatenate((numbers, none)), np.concatenate((self._inverse_warp, identities(surrounding)))

    def _checked_templates(
        self, corrected: Corrected, before: Array, frames: int, image: Images | None = None
    ) -> TrackedPoints:
        """Check after `frames` tracked frames whether templates need an update, plan it if so, and return the tracked
        points; `before` (N, 2) px are their positions before these frames.

        Their estimates are the last known positions. With template "previous" new templates are prepared from the last
        image.
        """
        self._gap = 0
        self._followed += frames
        points = corrected.found
        self._steps.append(corrected)
        if not self._by_key:
            self._templates = self._engine.prepare(image, points.points[0])
        elif self._followed % MOST_FRAMES == 0 or self._followed - self._checked >= self._interval:
            self._plan_template_update(corrected.warp[-1], corrected.shift[-1])
        return TrackedPoints(*points[:4], _last_seen(points.points, before))

    def _plan_template_update(self, warp: Array, shift: Array) -> None:
        """Plan new templates for the points whose window edges the deformation `warp` (N, 2, 2) has moved by more than
        `UPDATE_PX` since the template was made; `shift` (N,) px is this motion.

        An update is due `MOST_FRAMES` frames later, so that a stream has time to prepare it. Where the skin deforms so
        fast that the update interval is shorter, it is due as soon as possible.
        """
        window, frames = self._engine.settings.window_px, self._followed - self._checked
        change = np.sqrt(np.square(warp - self._warp).sum((-2, -1)))
        change = np.sort(change[np.isfinite(change)])
        fastest = window // 2 * float(change[int(0.95 * len(change))]) / frames if len(change) else 0.0
        # A power of 2, the largest in which edges of windows shift by at most `FASTEST_PX`.
        self._interval = 1 << int(math.log2(min(max(FASTEST_PX / max(fastest, 1e-9), 1), MOST_FRAMES)))
        self._warp, self._checked = warp, self._followed
        much = shift > UPDATE_PX
        for pending in self._pending:
            much[pending.rows] = False
        rows = much.nonzero()[0]
        if len(rows):
            later = MOST_FRAMES if self._interval == MOST_FRAMES else 0
            self._pending.append(_Pending(self._followed + later, rows, warp[rows], []))

    def _verified(self, images: Images, points: TrackedPoints) -> TrackedPoints:
        """Reject points whose window no longer resembles that in the key frame, or which dust on the glass holds back;
        return all points (n, N).

        Covariances count from the key frame. Points that fail are NaN, with status WINDOW_DIFFERS or DUST_IN_WINDOW.
        """
        check = self._verification.check
        if self._knowledge.ahead:
            verified = check(images, points.points, points.status, self._last_warp())
        else:
            if self._followed % MOST_FRAMES == 0:
                check(images, points.points, points.status, self._last_warp())
            verified = self._verification.latest
        if not self._by_key:
            variance = self._since_start(points.variance)
            points = points._replace(covariance=variance[..., None, None] * np.eye(2, dtype=np.float32))
        self.pull = np.concatenate((self.pull, np.broadcast_to(verified.variance, points.status.shape)))
        if not np.logical_or.reduce(verified.differs | verified.held, axis=None):
            return points
        tracked = points.status == TRACKED
        points = reject(points, tracked & verified.differs, TrackStatus.WINDOW_DIFFERS)
        return reject(points, tracked & verified.held & ~verified.differs, TrackStatus.DUST_IN_WINDOW)

    def _last_warp(self) -> Array:
        """Return the deformation gradients (N, 2, 2) of the skin around the points in the last frame relative to the
        key frame; those in the templates where unknown.
        """
        last = self._steps[-1]
        warp, valid = last.warp[-1], is_finite(last.expected[-1])
        return np.where(valid[:, None, None], warp, inverse_2x2(self._inverse_warp)) if self._by_key else warp

    def _since_start(self, variance: Array) -> Array:
        """Return the position variance (n, N) px^2 accumulated since the points were seeded: the sum over all
        frame-to-frame steps, of which `variance` (n, N) are the latest.
        """
        walked = self._walked + np.nan_to_num(variance).cumsum(0)
        self._walked = walked[-1:]
        return walked + 0 * variance


def select_frames(record: Record, frames: Any) -> Record:
    """Return a record of arrays (n, ...) for some of its frames, a slice or indices."""
    return type(record)(*[None if values is None else values[frames] for values in record])


def join(records: Sequence[Record], axis: int = 0) -> Record:
    """Join the contacts or tracking results of successive frames (`axis` 0), or the tracking results of groups of
    points in the same frames (1).
    """
    if len(records) == 1:
        return records[0]
    columns = zip(*records, strict=True)
    return type(records[0])(*[None if values[0] is None else np.concatenate(values, axis) for values in columns])


def _last_seen(points: Array, before: Array) -> Array:
    """Return positions (n, N, 2) in n frames with those of lost points, NaN, replaced by the last known position of
    each point.

    In the first frame it is that of `before` (N, 2).
    """
    positions = points.copy()
    for frame in positions:
        before = frame[:] = np.where(is_finite(frame)[:, None], frame, before)
    return positions
