"""Tracker of a stream: computes the results of each frame from the images received so far.

State that a frame reads and writes:

frame ──> inspect            reads   light of the glass (`FrameCheck`)
  │       (any thread)       gives   samples, hash of the block means, status by itself
  v
step      frame status       reads   samples of the last usable frame; `_steps`: the last 64 distances between frames;
  │       (`FrameCheck`)             `_returned`: which of the last 16 jumped away; `_keys`: hashes of the last 512
  │                          writes  the same, `_same`: which of the last 16 repeat an earlier frame, and
  │                                  `stale_views`: hashes of the frame before
  │       changes due        reads   `_change`, `_search`
  │       before it          writes  points and templates, `_seeding`, `threshold`; only while `_deferred` is empty
  │       undecided          writes  `_deferred`: frames that may have jumped, at most 3 behind the last usable one
  │       usable: tracking   reads   `_latest`, motion and templates of the key frame (`Points`), templates that are
  │       (`Points.follow`)          prepared (`Points._pending`)
  │                          writes  `_latest`, motion; every 8th frame, or sooner where skin deforms fast: verification
  │                                  of windows, plan of new templates
  │       no threshold yet   writes  `_held`: frames since the last in which it was measured, at most 3; they take that
  │                                  of the next
  │       reseeding          reads   `_requested`: by the user; `_sparse`: contact with few points
  │                          writes  `_reseeding`: counts of lost and of few points; `_change`: what is due next
  │       learning           reads   `_unlearnt`: outcomes whose contact is not evaluated yet, 2 frames behind
  │                          writes  `_search`: contact area, measured threshold; `_sparse`
  v
compute_  contact, covered   reads   `threshold` as of the frame
results   slip               writes  `SlipFlag`: positions at onset, frames in a row that say otherwise
(any      onset              writes  `Touches`: first frame, position and share of a step of each touch
thread)   entry              writes  `Entries`: positions, variances and borders of the last 512 frames
  │       deviations         writes  every 4th frame `Curvature`, every 8th `Deformation` and errors of onset
  v
results by name
"""

import math
import threading
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from fingerflow.engines.contact_view import covers, glass_light
from fingerflow.engines.engine import TRACKED, Engine, FrameContact, Images, TrackedPoints
from fingerflow.kernels.array_types import Array
from fingerflow.kernels.arrays import is_finite
from fingerflow.recordings.lens import Geometry
from fingerflow.schema.variables import USABLE
from fingerflow.tracker.faint_rim import check_faint_rim, pale_rim
from fingerflow.tracker.frame_results import FrameResults, Seeding
from fingerflow.tracker.points import STREAM, Points, join
from fingerflow.tracker.reseeding import CONTACT, REKEY, ReseedingSchedule, ThresholdSearch
from fingerflow.tracker.stream_frame_quality import FrameCheck, Picture

CONTACT_VIEW, TOPOGRAPHY_VIEW = "contact_view", "topography_view"
PAGE = "page"  # cause of a reseeding that the user has requested on the live page
_REKEY_SHARE = 0.8
# Number of frames after which a frame's contact serves to learn the threshold: it is computed in parallel with these
# frames.
_LEARNT_AFTER = 2
_LOOK_EVERY = 2  # frames between two counts of the points in contact
_LARGER = 1.05  # least ratio of contact areas at which the image of the larger contact is kept
_LEAST_MM2 = 1.0  # mm², least area of a contact whose points are counted, and whose rim is judged
# Spacings of points in gauge lengths. The first is the largest with which fits have neighbours up to the border: in a
# stream of the fast recipe, medians are unknown in 24 % of the frames with 1/3 and in 0.5 % with 0.3. The second is
# that of newly seeded points.
_SPARSE, _DENSE = 0.3, 1 / 4
_EVERYTHING = 0.98  # share of the pixels: a threshold is rejected if more of them exceed it
_PIXELS = 20_000  # number of pixels read to estimate this share


@dataclass(frozen=True)
class TrackerSettings:
    """Experiment settings for the tracker of a stream.

    Attributes:
        points: N, the largest number of seeded points and the size of all results of points.
        bit_depth: of a pixel.
        geometry: of the views.
        region: (H, W) bool of the topography view, in which points are seeded.
        threshold: relative intensity loss above which a pixel touches; None to measure it.
        update_share, update_frames: a new key frame is taken when less than this share of its points is tracked, or
            after so many frames.
    """

    points: int
    bit_depth: int
    geometry: Geometry
    region: Array
    threshold: float | None
    update_share: float | None
    update_frames: float | None


class Frame:
    """Input frame of a stream: contact view and topography view, samples and frame status.

    Attributes:
        number: of the frame; numbers increase but may have gaps.
        views: both views (1, 1, H, W) by name.
        picture: samples of the views and the status, set by `StreamTracker.inspect`.
    """

    def __init__(self, views: Mapping[str, Array], number: int = 0) -> None:
        self.number, self.views = number, views
        self.picture: Picture | None = None


@dataclass
class FrameOutcome:
    """Frame in progress, from `StreamTracker.step` to `StreamTracker.compute_results`, and then its final outcome.

    Attributes:
        index: of the frame in the stream, from 0.
        frame: the frame itself.
        images: both views, in the engine's own representation.
        threshold: relative intensity loss above which a pixel touches; NaN while unknown, and if the frame does not
            count.
        points: tracked in it; None if the frame does not count.
        pull: (1, N) px^2, of the points (`Points.pull`).
        measured: threshold measured in it, NaN for none; None if none was to be measured.
        contact: set once it is computed (`StreamTracker.compute_results`); guarded by the lock `computing`.
        status: index into `FRAME_STATUS`.
        seeding: seeded points to which `points` belong; None before any were seeded.
        tracked: number of points with status TRACKED.
        key_frame: number of its key frame.
        restart: number of times that points had been seeded.
    """

    index: int
    frame: Frame
    images: dict[str, Images]
    threshold: float
    points: TrackedPoints | None = None
    pull: Any = None
    measured: float | None = None
    contact: FrameContact | None = None
    computing: threading.Lock = field(default_factory=threading.Lock)
    status: int = USABLE
    seeding: Seeding | None = None
    tracked: int = 0
    key_frame: int = 0
    restart: int = 0


class Event(NamedTuple):
    """Event of a stream, such as a seeding or a new key frame: name, frame number and details."""

    name: str
    frame: int
    facts: dict[str, Any]


class _Change(NamedTuple):
    """Deferred change of the tracked points: a reseeding or a new key frame, from the image of an earlier frame.

    `number`, `image` and `points` belong to that frame. New points are seeded in `region` (H, W), and replace others
    if more than `least` of them lie in `counted` (H, W).
    """

    number: int
    image: Array
    points: Array
    cause: str
    region: Array
    counted: Array
    least: int


class _Sparse(NamedTuple):
    """Contact with too few tracked points: their number, centre (2,) px, semi-axes (2,) px and angle of the contact's
    ellipse in the contact view, and the larger semi-axes (2,) of the region in which others are to be seeded.
    """

    points: int
    center: Array
    semi_axes: Array
    angle: float
    wide: Array


class StreamTracker:
    """Tracker of a stream: state between frames, and the method `step` for each frame.

    `step` decides with the frames before it whether a frame counts, and tracks the points of one that does.
    `compute_results` computes contact and results, in another thread where frames wait to be
    tracked. Both take frames in order. The results of a frame depend only on the frames before it, not on wall-clock
    time or on the progress of threads.

    Without a given threshold there is no contact until one was measured.

    Args:
        engine: that computes.
        settings: experiment settings.
        glass, dark: (H, W) contact view of the empty glass, and without light.

    Attributes:
        check: of the frames.
        geometry: of the views.
        results: of frames, and their state.
        threshold: relative intensity loss above which a pixel touches; NaN while unknown.
        measures: whether it is measured in frames.
        seeded: number of points seeded at the last restart.
        restarts, keys: number of seedings, and of further key frames taken for the same points.
    """

    def __init__(self, engine: Engine, settings: TrackerSettings, glass: Array, dark: Array) -> None:
        self._engine, self._settings = engine, settings
        self._light = glass_light(glass, dark)
        self._glass, self._dark = glass, dark
        self.geometry = settings.geometry
        self._to_contact = self.geometry.topography_to_contact.astype(np.float32)
        self.results = FrameResults(engine, self.geometry)
        self.check = FrameCheck(glass, dark, settings.bit_depth)
        self.threshold = math.nan if settings.threshold is None else settings.threshold
        self.measures = settings.threshold is None
        self._search = ThresholdSearch(1 + _LEARNT_AFTER)
        self._reseeding = ReseedingSchedule(settings.update_share or _REKEY_SHARE, settings.update_frames or math.inf)
        self._points: Points | None = None
        self._latest = 0  # number of the latest frame in which points were seeded or tracked
        self._index = -1  # of the latest frame in the stream
        self._change: _Change | None = None
        self._requested = False
        self._deferred: deque[FrameOutcome] = deque()  # frames whose status later frames decide
        self._seeding: Seeding | None = None
        self._held: list[FrameOutcome] = []  # outcomes that wait for the first threshold
        self._sparse: _Sparse | None = None
        self._largest: tuple[Images, FrameContact] | None = None  # contact view with the largest contact, and contact
        # Outcomes of frames whose contact is not evaluated yet: its area tells when to measure the threshold again, and
        # tracked points in it are counted. With the index of the latest frame when the outcome was decided, and the
        # number of the frame, as a `Frame` with results is reused for another image.
        self._unlearnt: deque[tuple[int, int, FrameOutcome]] = deque()
        self.seeded = self.restarts = self.keys = 0

    def warm_up(self, frame: Frame) -> None:
        """Process a blank frame in a separate tracker before a stream starts, since the first engine calls are slow."""
        tracker = StreamTracker(self._engine, replace(self._settings, threshold=None), self._glass, self._dark)
        for number in range(2):
            frame.number = number
            tracker.inspect(frame)
            assert frame.picture is not None
            frame.picture = frame.picture._replace(status=USABLE)
            for outcome in (*tracker.step(frame), *tracker.settle()):
                if isinstance(outcome, FrameOutcome):
                    tracker.compute_results([outcome])

    def inspect(self, frame: Frame) -> None:
        """Sample the views of a frame, and determine the frame status from it alone; safe in any thread."""
        frame.picture = self.check.inspect(frame.number, frame.views)

    def reseed(self) -> None:
        """Request a reseeding of the points as soon as possible; safe in any thread."""
        self._requested = True

    def step(self, frame: Frame) -> list[Event | FrameOutcome]:
        """Track the points of the next frame, and return the events and frame outcomes that are now final.

        Events due before the frame are a seeding or a new key frame; they wait until no frame is deferred. Outcomes are
        those of deferred frames before it, and its own unless it is deferred too.
        """
        self._index += 1
        passed: list[Event | FrameOutcome] = []
        assert frame.picture is not None
        statuses = self.check.update(frame.picture)
        if not self._deferred:
            passed += self._make_changes(frame, USABLE in statuses)
        images = {name: self._engine.images(view[0]) for name, view in frame.views.items()}
        work = FrameOutcome(self._index, frame, images, self.threshold)
        if self.measures and self._search.wants(self._index):
            self._measure_threshold(work)
        self._deferred.append(work)
        passed += self._decided(statuses)
        while len(self._unlearnt) > len(self._held) and self._unlearnt[0][0] <= self._index - _LEARNT_AFTER:
            passed += self._learn_contact(*self._unlearnt.popleft())
        return passed

    def _decided(self, statuses: list[int]) -> list[FrameOutcome]:
        """Finish the first of the deferred frames, whose `statuses` are now decided, and return the outcomes that are
        final: a usable frame updates points and templates, another is skipped.

        Until the first threshold is known, outcomes wait for the next frame in which it is measured. A contact that
        begins between two such frames is then seen from its first frame on.
        """
        final: list[FrameOutcome] = []
        for status in statuses:
            work = self._deferred.popleft()
            self._held.append(self._tracked(work) if status == USABLE else self._outcome(work, status))
            if work.measured is not None or not math.isnan(self.threshold):
                final += self._release()
        return final

    def _release(self) -> list[FrameOutcome]:
        """Return the outcomes that wait for a threshold, with the first one if the last usable of them shows contact.

        This is the frame in which it is measured, or the one before if that does not count or has not come. The first
        threshold applies at once, as there is no other yet.
        """
        held, self._held = self._held, []
        usable = [outcome for outcome in held if outcome.status == USABLE]
        if usable and math.isnan(self.threshold):
            self.threshold = self._measure_threshold(usable[-1])
        for outcome in usable:
            outcome.threshold = self.threshold if math.isnan(outcome.threshold) else outcome.threshold
        return held

    def compute_results(self, outcomes: Sequence[FrameOutcome]) -> dict[str, Array]:
        """Compute the results of consecutive usable frames with points of one seeding, as arrays (n, ...) by variable
        name.

        Frames are given in order, from any thread: tracking does not depend on the results. Several at once take less
        time, and have the same results to rounding of float32. After an exception they can be computed again, without
        displacements of skin in contact.
        """
        seeding, tracked = outcomes[0].seeding, [outcome.points for outcome in outcomes if outcome.points is not None]
        assert seeding is not None
        contacts = [self.contact(outcome) for outcome in outcomes]
        # The results do not use the mask, the largest part of a contact.
        contact = join([each._replace(real_contact_mask=None) for each in contacts])
        try:
            pull = np.concatenate([outcome.pull for outcome in outcomes])
            results = self.results.compute(seeding, contact, join(tracked), pull)
        except Exception:  # some frames may have been counted: what is measured from the onset is unknown from here on
            begun = seeding._replace(before=None)
            for outcome in outcomes:
                outcome.seeding = begun
            raise
        for outcome, contact in zip(outcomes, contacts, strict=True):
            if contact.gross_area_px[0] > _LARGER * (self._largest[1].gross_area_px[0] if self._largest else 0):
                self._largest = outcome.images[CONTACT_VIEW].copy(), contact
            if self._points is not None:
                self._points.prepare_ahead()
        return results

    def check_faint_rim(self) -> Iterator[str]:
        """Yield a warning if the largest contact so far is faint at its rim. A contact that has just begun gives none:
        it shows too few ridges. Safe in any thread.
        """
        if self._largest is not None:
            image, contact = self._largest
            gross, rim = pale_rim(self._engine, image, self._light, contact, self.results.on_glass)
            if gross >= _LEAST_MM2:
                yield from check_faint_rim(rim, gross, contact.threshold[0], self._engine.settings.gross_radius_px, 0.0)

    def settle(self) -> list[FrameOutcome]:
        """Finish the frames that wait for later frames or for a threshold as the stream ends; return their outcomes."""
        return self._decided(self.check.finish()) + self._release()

    def _measure_threshold(self, work: FrameOutcome) -> float:
        """Return the threshold measured in a frame, NaN for none; it is measured at the first call.

        Even an empty glass gives a threshold, of noise or outside 0 to 1. In contact the valleys of the skin do not
        touch, so a threshold that nearly all pixels exceed is wrong.
        """
        if work.measured is None:
            view = work.frame.views[CONTACT_VIEW][0, 0]
            lost = float(self._engine.contact(work.images[CONTACT_VIEW], self._light).threshold[0])
            step = max(1, round((view.size / _PIXELS) ** 0.5))
            seen, empty, black = (image[::step, ::step].astype(np.float32) for image in (view, self._glass, self._dark))
            physical = 0 < lost < 1 and (seen - black < (1 - lost) * (empty - black)).mean() < _EVERYTHING
            work.measured = lost if physical else math.nan
        return work.measured

    # Changes that are made before a frame begins.

    def _make_changes(self, frame: Frame, usable: bool) -> list[Event]:
        change, threshold = self._change, self._search.due(self._index)
        events: list[Event] = []
        if not self.restarts and usable:
            view = frame.views[TOPOGRAPHY_VIEW][0]
            events.append(self._restart(frame.number, view, self._seed(view, self._settings.region), "start"))
        if threshold is not None:
            self.threshold = threshold
            self._search.used()
        if change is not None:
            self._change = None
            events += [self._rekey(change)] if change.cause == REKEY else self._reseed(change)
        return events

    def _seed(self, view: Array, region: Array) -> Array:
        """Detect corners of a view (1, H, W) inside a region (H, W): positions (N, 2) px, padded with NaN."""
        points = np.full((self._settings.points, 2), np.nan, np.float32)
        corners = self._engine.detect(self._engine.images(view), region, len(points))
        points[: len(corners)] = corners
        return points

    def _reseed(self, change: _Change) -> list[Event]:
        """Replace the tracked points by new ones if these are more, or if a user requests it and any are detected."""
        points = self._seed(change.image, change.region)
        column, row = np.rint(points[is_finite(points)]).astype(int).T
        if change.counted[row, column].sum() > change.least:
            return [self._restart(change.number, change.image, points, change.cause, change.points)]
        self._reseeding.keep(self._index)
        return []

    def _restart(self, number: int, view: Array, points: Array, cause: str, before: Array | None = None) -> Event:
        """Start to track newly seeded points (N, 2) px with the image `view` of frame `number` as key frame; values
        counted from contact onset restart. Return the event.
        """
        motion = None if self._points is None else self._points.motion.seeded(points)
        self._points = Points(self._engine, self._engine.images(view), points, motion=motion, knowledge=STREAM)
        self.seeded, self._latest = int(is_finite(points).sum()), number
        self._seeding = Seeding(points, before)
        self._reseeding.restarted(self._index, number, self.seeded)
        self._search.begin()
        self.restarts += 1
        return Event("restart", number, {"cause": cause, "points": self.seeded})

    def _rekey(self, change: _Change) -> Event:
        """Take a newer frame, in which the tracked points lie at `change.points`, as their key frame, the frame with
        which later ones are compared; return the event.
        """
        assert self._points is not None
        valid, motion = is_finite(change.points), self._points.motion
        motion = motion._replace(position=np.where(valid[:, None], motion.position, np.float32(np.nan)))
        image = self._engine.images(change.image)
        self._points = Points(self._engine, image, change.points, motion=motion, knowledge=STREAM)
        self._reseeding.keyed(change.number, int(valid.sum()))
        self.keys += 1
        return Event("key_frame", change.number, {"points": int(valid.sum())})

    # Outcome of a frame after its computation.

    def _tracked(self, work: FrameOutcome) -> FrameOutcome:
        """Track the points of a usable frame, decide whether a reseeding or a new key frame is due, and return the
        frame's outcome.

        A threshold, a reseeding or a key frame that it gives counts from the latest frame of the stream: a deferred
        frame is an earlier one.
        """
        points, frame = self._points, work.frame
        assert points is not None
        if frame.number == self._latest:  # the key frame
            tracked_points = points.as_seeded
        else:
            points.pass_over(frame.number - self._latest - 1)
            tracked_points, self._latest = points.follow(work.images[TOPOGRAPHY_VIEW]), frame.number
        tracked = int(np.add.reduce(tracked_points.status[0] == TRACKED))
        if self._change is None:
            cause = PAGE if self._requested else self._reseeding.update(self._index, frame.number, tracked)
            if cause:
                self._requested = False
                image = frame.views[TOPOGRAPHY_VIEW][0].copy()
                region = counted = self._settings.region
                least = 0 if cause == PAGE else tracked
                if cause == CONTACT and self._sparse is not None:
                    least, (counted, region) = self._sparse.points, self._regions(self._sparse)
                positions = tracked_points.points[0].copy()
                self._change = _Change(frame.number, image, positions, cause, region, counted, least)
        work.pull = points.pull
        return self._outcome(work, USABLE, tracked_points, tracked)

    def _outcome(
        self, work: FrameOutcome, status: int, points: TrackedPoints | None = None, tracked: int = 0
    ) -> FrameOutcome:
        """Return the outcome of a frame with its tracked points, None if it is not usable, and queue it for
        `_learn_contact`, which evaluates its contact later.
        """
        work.threshold = work.threshold if status == USABLE else math.nan
        work.status, work.points, work.tracked, work.seeding = status, points, tracked, self._seeding
        work.key_frame, work.restart = self._reseeding.key_frame, self.restarts
        self._unlearnt.append((self._index, work.frame.number, work))
        return work

    def contact(self, work: FrameOutcome) -> FrameContact:
        """Return the contact (mask, areas, ellipse) of a frame, computed at the first call, in whichever thread that
        happens.
        """
        with work.computing:
            if work.contact is None:
                threshold = np.array([work.threshold], np.float32)
                work.contact = self._engine.contact(work.images[CONTACT_VIEW], self._light, threshold)
            return work.contact

    def _learn_contact(self, index: int, number: int, outcome: FrameOutcome) -> list[Event]:
        """Learn from the contact of frame number `number`, whose outcome was decided when the frame with this index was
        the latest, whether to reseed and which threshold to use; return the event of a new threshold.
        """
        if outcome.points is not None and outcome.seeding is self._seeding and outcome.index % _LOOK_EVERY == 0:
            touching = self.results.on_glass.sizes(self.contact(outcome)).gross[0] >= _LEAST_MM2
            self._sparse = self._sparse_contact(outcome, outcome.points) if touching else None
            self._reseeding.record_contact(touching, self._sparse is not None)
        if not self.measures:
            return []
        measured = outcome.measured
        if outcome.points is not None:
            if self._search.update(index, float(self.contact(outcome).real_area_px[0]), measured):
                return [Event("threshold", number, {"threshold": measured})]
        elif measured is not None:
            self._search.passed_over()
        return []

    def _sparse_contact(self, work: FrameOutcome, tracked_points: TrackedPoints) -> _Sparse | None:
        """Return the contact of a frame and how far around it to seed new points if fewer tracked points lie in this
        contact than local fits need; None otherwise.

        New points are to be seeded in the ellipse of the contact, enlarged so that all points lie a fourth of a gauge
        length apart: a contact that has just begun grows about its place.
        """
        contact = self.contact(work)
        area = float(self.results.on_glass.sizes(contact).gross[0])
        gauge = self._engine.settings.gauge_length_mm
        covered = covers(contact.density_margin, tracked_points.estimate, self._to_contact, self._engine.cell_px)[0]
        points = int(np.add.reduce(covered & (tracked_points.status[0] == TRACKED)))
        # Points are not replaced either where even all of them would be too few.
        if not points * (_SPARSE * gauge) ** 2 < area < self._settings.points * (_SPARSE * gauge) ** 2:
            return None
        # px², product of the semi-axes of the seeding region.
        product = self._settings.points * (_DENSE * gauge) ** 2 * float(contact.gross_area_px[0]) / area / math.pi
        axes = contact.semi_axes[0].astype(np.float64)
        wider = (math.hypot(axes[0] - axes[1], 2 * math.sqrt(product)) - axes.sum()) / 2
        window = self._engine.settings.window_px * self.geometry.magnification
        return _Sparse(points, contact.center[0].copy(), axes, float(contact.angle[0]), axes + max(wider, window))

    def _regions(self, sparse: _Sparse) -> tuple[Array, Array]:
        """Return the mask (H, W) of a contact in the topography view, and that of the region around it in which points
        are to be seeded.
        """
        rows, columns = np.ogrid[tuple(map(slice, self._settings.region.shape))]
        cosine, sine = math.cos(sparse.angle), math.sin(sparse.angle)
        about_center = self._to_contact.copy()
        about_center[:, 2] -= sparse.center
        along, across = (
            (by_x * columns).astype(np.float32) + (by_y * rows + shift).astype(np.float32)
            for by_x, by_y, shift in np.array([[cosine, sine], [-sine, cosine]]) @ about_center
        )
        inside, around = (
            self._settings.region & (np.square(along / major) + np.square(across / minor) < 1)
            for major, minor in (sparse.semi_axes.tolist(), sparse.wide.tolist())
        )
        return inside, around
