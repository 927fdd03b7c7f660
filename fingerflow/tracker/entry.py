"""Entry of skin points into the contact: by growth of the contact, or by advection over the contact's border.

Also the gradients of advected points since their entry. Where a contact grows over skin, the onset positions of
neighbours are as far apart as the neighbours, and the gradient of displacement with respect to onset positions is the
usual one. Skin that is advected over a border at rest comes into contact along one line: the onset positions of an area
of skin span no area, and this gradient does not exist (`synthetic.Truth.gradient` is NaN there). What can be measured
of such skin is its deformation since its own entry, all neighbours counted from that moment: with F the gradient of
position with respect to position in a common frame, F(t) F(entry)^-1 - I.
"""

import numpy as np

from fingerflow.engines.engine import Engine, EnteredPoints
from fingerflow.kernels.array_types import Array
from fingerflow.kernels.arrays import inverse_2x2, is_finite, nanmedian, squared_distances
from fingerflow.kernels.result_records import FrameEllipse
from fingerflow.tracker.contact_border import BORDER_MM
from fingerflow.tracker.deviations.onset_time import onset_errors
from fingerflow.tracker.vibration import Values, vibration

#: Distance, in gauge lengths, over which the motion of a point before its onset is compared with that of the border.
MOVED = 1 / 8
#: Distance, in gauge lengths, within which points are neighbours.
NEAR = 1 / 2
# Ratio of the area of onset positions to that of the skin, below which the times of entry shape the displacement more
# than the skin does.
LEAST_AREA = 0.5
_EVERY = 8  # frames between two computations of the errors of onsets in a stream
_VOTERS = 3  # number of neighbours that decide on a point
_VALUES = 1 << 16  # positions read at a time, of 64 frames at least
_EYE = np.eye(2)


def advected(
    position: Values, positions: Array, onset: Array, reference: Array, gauge_mm: float, border: FrameEllipse
) -> Array:
    """Return a mask (N,) of the points that the motion of the skin carried over the border into the contact (advected);
    the other points were reached as the contact area grew over them.

    A point was advected if its onset is not the first of all and if, before it, the point moved over the glass by more
    than half the distance by which border and point approached each other. Neighbours enter one after the other as the
    border passes them, and their onset positions are off by their motion in between. Displacements counted from there
    contain this strain; where it is a half, the times of entry shape them more than the skin does. The rule holds where
    skin slides in under a border at rest, where it moves along the border, and where both move together and the onset
    of a point at the border is detected late.

    The motion is compared over the last eighth of the gauge length before the onset, of the point's way or of the
    approach, or over all that is known if this is less. Where a contact stops growing and its skin is dragged, a point
    just outside enters by its own motion, however far the border came before. A motion below the uncertainty of the
    border's position decides nothing. If there was no contact when a point began to move, the contact has grown over
    the point.

    Points of which most neighbours were advected count too, because too little may be known of a point itself.

    Args:
        position: (frames, N, 2) mm.
        positions: (N, 2) mm, in a frame that is the same for all.
        onset: (N,) frame, -1 for none.
        reference: (N, 2) mm, positions at onset.
        gauge_mm: gauge length of the fits.
        border: of the apparent (gross) contact in the same frames.
    """
    valid = np.isfinite(positions + reference).all(1) & (onset >= 0)
    counts = valid & (onset > onset[valid].min(initial=np.iinfo(np.int32).max))
    here = counts.nonzero()[0]
    entered = np.zeros(len(onset), dtype=bool)
    entered[here] = _entered_by_motion(position, here, onset[here], reference[here], gauge_mm, border)
    return extend_to_neighbours(entered, positions, counts, NEAR * gauge_mm)


def _entered_by_motion(
    position: Values, here: Array, onset: Array, reference: Array, gauge_mm: float, border: FrameEllipse
) -> Array:
    """Return a mask (E,) of the points that came into the contact mainly by their own motion over the glass: before
    their onset of contact they moved by more than half the distance by which point and border approached each other.

    `here` (E,) are the indices of these points in `position`.
    """
    way, inside = np.full((2, len(here)), np.nan)
    then = border.select(onset).inside(reference[:, None])[:, 0]
    together = max(64, _VALUES // max(len(here), 1))
    for first in range(0, position.shape[0] if len(here) else 0, together):
        frames = slice(first, min(first + together, position.shape[0]))
        rows = position[frames].take(here, axis=1)
        # Each component separately, as NumPy is slow over an axis of two.
        way_x, way_y = rows[..., 0] - reference[:, 0], rows[..., 1] - reference[:, 1]
        moved, depth = np.sqrt(way_x * way_x + way_y * way_y), border.select(frames).inside(rows)
        before = (np.arange(frames.start, frames.stop)[:, None] < onset) & np.isfinite(moved)
        far = before & ((moved >= MOVED * gauge_mm) | (then - depth >= MOVED * gauge_mm))
        last, is_far = len(far) - 1 - far[::-1].argmax(0), np.logical_or.reduce(far)
        decided = (is_far | (np.logical_or.reduce(before) & np.isnan(way))).nonzero()[0]
        row = np.where(is_far, last, before.argmax(0))[decided]
        way[decided], inside[decided] = moved[row, decided], depth[row, decided]
    return (way > BORDER_MM) & (LEAST_AREA * (then - inside) < way)


def extend_to_neighbours(entered: Array, positions: Array, among: Array, reach_mm: float) -> Array:
    """Extend a mask `entered` (N,) to each point of the mask `among` (N,) of whose three nearest points in `among` at
    least two are marked; positions are `positions` (N, 2) mm.

    Only neighbours within `reach_mm` count.
    """
    candidates = among.nonzero()[0]
    if len(candidates) <= _VOTERS or not np.logical_or.reduce(entered):
        return entered
    away = squared_distances(positions[candidates], positions[candidates])
    np.fill_diagonal(away, np.inf)
    near = np.argpartition(away, _VOTERS - 1, axis=1)[:, :_VOTERS]
    within = np.take_along_axis(away, near, axis=1) < reach_mm**2
    result = entered.copy()
    result[candidates[(entered[candidates][near] & within).sum(1) > _VOTERS / 2]] = True
    return result


def variance_of_late(late: Array) -> Array:
    """Return the variances (2, N) of divergence and curl by an uncertain time of entry, from the errors `late`
    (N, 2, 2) of the displacement gradients by one standard deviation of this time.
    """
    return np.square((late[:, 0, 0] + late[:, 1, 1], late[:, 1, 0] - late[:, 0, 1]))


def join_entered(frames: list[EnteredPoints | None]) -> EnteredPoints | None:
    """Join the entered points of n frames, each None where no point has entered; None if none has."""
    known = [frame for frame in frames if frame is not None]
    if not known:
        return None
    among, gradient, covariance = known[0]
    nothing = EnteredPoints(*map(np.zeros_like, (among, gradient, covariance)))
    return EnteredPoints(*map(np.concatenate, zip(*(frame or nothing for frame in frames), strict=True)))


class EntryGradients:
    """Displacement gradients of advected points since each of them entered the contact.

    Attributes:
        change: (N, 2, 2) of the gradient at a point in a frame before its entry; 0 where it is not known.
    """

    #: Frames before the entry over which the change of a gradient is measured.
    BEFORE = 4

    def __init__(self, engine: Engine, positions: Array) -> None:
        """`positions` (N, 2) mm are those by which points are neighbours; NaN for none."""
        self._engine, self._positions, self._valid = engine, positions, is_finite(positions).nonzero()[0]
        self._at_entry, self.change = np.full((len(positions), 2, 2), np.nan), np.zeros((len(positions), 2, 2))
        self._covariance = np.full((len(positions), 2, 2, 2, 2), np.nan)

    def learn(self, points: Array, entry: tuple[Array, Array], before: tuple[Array, Array]) -> None:
        """Store the state in which `points` (E,), indices, entered the contact, from the positions (1, N, 2) mm of all
        points and their variance (1, N) mm^2 in the frame of the entry and in that `BEFORE` frames before.
        """
        gradient, self._covariance[points] = self._fit(points, *entry)
        self._at_entry[points] = gradient
        self.change[points] = np.nan_to_num(gradient - self._fit(points, *before)[0]) / self.BEFORE

    def forget(self, points: Array) -> None:
        """Forget the entry of `points` (N,) bool, whose next touch begins."""
        self._at_entry[points], self.change[points] = np.nan, 0

    def since_entry(self, points: Array, position: Array, variance: Array) -> EnteredPoints:
        """Return the advected `points` (E,), indices, with their displacement gradients since their entry in n frames,
        from the positions (n, N, 2) mm of all points and their variance (n, N) mm^2.

        A gradient is with respect to positions at the entry; it is NaN where too little is known. The variance is that
        of a component relative to the frame in which points were seeded. Half of it belongs to that frame and is the
        same at all times. The covariance is to first order, as if the skin had not deformed before the entry.
        """
        gradient, spread = self._fit(points, position, variance)
        among = np.zeros(variance.shape, dtype=bool)
        among[:, points] = True
        since, covariance = (np.full((*among.shape, *(2,) * axes), np.nan, np.float32) for axes in (2, 4))
        since[:, points] = gradient @ inverse_2x2(self._at_entry[points]) - _EYE
        covariance[:, points] = spread + self._covariance[points]
        return EnteredPoints(among, since, covariance)

    def _fit(self, points: Array, position: Array, variance: Array) -> tuple[Array, Array]:
        """Return the deformation gradients (n, E, 2, 2) of the skin at E of the N points in n frames, from positions
        (n, N, 2) mm with respect to those in the common frame, and their covariances (n, E, 2, 2, 2, 2).
        """
        valid, positions = self._valid, self._positions
        moved, noise = (position - positions)[:, valid], variance[:, valid] / 2
        gauge_mm = self._engine.settings.gauge_length_mm
        gradient, spread = self._engine.fit(positions[valid], moved, positions[points], gauge_mm, noise)
        assert spread is not None
        return _EYE + gradient, spread


class Entries:
    """Onsets of contact in a stream, as far as the frames so far tell: which points the skin's motion carries into the
    contact (advected), their displacement gradients since that entry, and the errors of the times of onset.

    The methods are those of `advected`, `EntryGradients` and `deviations.onset_time`, applied to the frames so far.
    Positions of the points and borders of the contact are kept for the last `KEPT` frames.

    Args:
        positions: (N, 2) mm, where points were seeded; NaN for none.

    Attributes:
        entered: (N,) bool, points that have been advected into the contact.
        onset: (N,) index of the frame in which the present touch began, -1 without one.
        of_onset: (N, 2, 2) mm^2, covariance of the displacements by the error of the time of onset. Until
            `learn_errors` computes it, it is the mean of the points that touched before.
    """

    KEPT = 512  # number of latest frames that are kept, in which the motion before an onset is known

    def __init__(self, engine: Engine, positions: Array) -> None:
        count = len(positions)
        self._engine, self._seeded, self._gauge = engine, positions, engine.settings.gauge_length_mm
        self._gradients = EntryGradients(engine, positions)
        self._position, self._variance = np.full((self.KEPT, count, 2), np.nan), np.full((self.KEPT, count), np.nan)
        self._covered = np.zeros((self.KEPT, count), dtype=bool)
        self._border = FrameEllipse(*(np.full((self.KEPT, *size), np.nan) for size in ((2,), (2,), ())))
        # Number of frames so far, and of the frame after the first in which the first point touched.
        self._frames = self._begun = 0
        self.onset, self._reference = np.full(count, -1), np.full((count, 2), np.nan)
        self.entered, self._by_motion = np.zeros((2, count), dtype=bool)  # second: by their own motion
        self.of_onset = np.zeros((count, 2, 2))
        self._mean_of_onset, self._variance_of_time, self._mean_of_time = np.zeros((2, 2)), np.zeros(count), 0.0

    def update(
        self, position: Array, variance: Array, covered: Array, begins: Array, touching: Array, reference: Array,
        border: FrameEllipse,
    ) -> EnteredPoints | None:  # fmt: skip
        """Add the next frame, and return the advected points with their displacement gradients in it (1, N, ...), each
        relative to the frame in which the point entered the contact; None if no point in contact has entered.

        Gradients are NaN for lost points.

        Args:
            position: (N, 2) mm, NaN where lost.
            variance: (N,) mm^2, of a component, relative to the frame in which points were seeded.
            covered: (N,) bool, whether the contact covers each point.
            begins, touching: (N,) bool, whether a touch begins in this frame, and whether there is one.
            reference: (N, 2) mm, where the touch began.
            border: of the apparent contact, of this frame.
        """
        row = self._frames % self.KEPT
        self._position[row], self._variance[row], self._covered[row] = position, variance, covered
        for history, new in zip(self._border, border, strict=True):
            history[row] = new[0]
        self.onset[~touching], self.entered[~touching], self._by_motion[~touching] = -1, False, False
        if np.logical_or.reduce(begins):
            self._begun = self._begun or self._frames
            self.onset[begins], self._reference[begins] = self._frames, reference[begins]
            self._gradients.forget(begins)
            self.of_onset[begins], self._variance_of_time[begins] = self._mean_of_onset, self._mean_of_time
            before = self.entered.copy()
            self._mark_advected(begins)
            self._learn_entries(self.entered & ~before)
        self._frames += 1
        here = (self.entered & is_finite(position)).nonzero()[0]
        if not len(here):
            return None
        return self._gradients.since_entry(here, *self._kept(row))._replace(among=self.entered[None].copy())

    def _kept(self, row: int) -> tuple[Array, Array]:
        """Return positions (1, N, 2) mm and variances (1, N) mm^2 of all points in the stored frame number `row`."""
        return self._position[row][None], self._variance[row][None]

    def _learn_entries(self, new: Array) -> None:
        """Compute the gradients at their entry of points that are newly marked as advected, `new` (N,) bool."""
        for onset in set(self.onset[new].tolist()):
            rows = onset % self.KEPT, (onset - EntryGradients.BEFORE) % self.KEPT
            points = (new & (self.onset == onset) & is_finite(self._position[rows[0]])).nonzero()[0]
            if len(points):
                self._gradients.learn(points, *map(self._kept, rows))

    def check_vibration(self, mm_per_px: float) -> list[str]:
        """Return a warning if the whole image vibrates in the kept frames; safe in any thread."""
        frames = self._frames
        order = np.arange(max(frames - self.KEPT + 8, 0), frames) % self.KEPT  # the oldest are written meanwhile
        counted = "displacement and strain contain this motion"
        kept = np.arange(len(order))
        return vibration(self._position[order], self._covered[order], kept, mm_per_px, counted)[1] if frames else []

    def learn_errors(self, faint_mm: float) -> None:
        """Compute the errors of the times of onset of the points that have touched in the last 16 frames, as the motion
        around their onset is known by now, or in part.

        They are computed after every eighth frame, and after each of the 16 frames in which the first points touch: no
        others, whose mean would do, have touched before.
        """
        if self._frames % _EVERY and self._frames >= self._begun + 2 * _EVERY:
            return
        recent = self.onset >= max(self._frames - 2 * _EVERY, 1)
        first, last = max(self._frames - self.KEPT, 0), self._frames - 1
        if not recent.any():
            return
        points = np.arange(len(self.onset))

        def positions(frames: Array) -> tuple[Array, Array]:
            rows = (frames + first) % self.KEPT
            return self._position[rows, points], np.sqrt(self._variance[rows, points])

        border = self._border.select(np.arange(first, last + 1) % self.KEPT)
        onset, frames = self.onset - first, (-first, last - first)
        known = onset, self._reference, self.entered, frames, positions, border
        variance, of_onset, _ = onset_errors(self._engine, *known, faint_mm)
        self.of_onset[recent], self._variance_of_time[recent] = of_onset[recent], variance[recent]
        self._mean_of_onset, self._mean_of_time = of_onset[recent].mean(0), nanmedian(variance[recent][None])[0]

    @property
    def late(self) -> Array:
        """Return the errors (N, 2, 2) of the gradients of advected points by one standard deviation of the time of
        entry: their change before it, in proportion; 0 for other points.
        """
        return (self.entered * np.sqrt(self._variance_of_time))[:, None, None] * self._gradients.change

    def _mark_advected(self, begins: Array) -> None:
        """Update the mask `entered` (N,) of advected points: test which of the points whose touch begins in this frame,
        `begins` (N,) bool, came into the contact by their own motion, and add those most of whose neighbours did.
        """
        first = max(self._frames + 1 - self.KEPT, 0)
        order = np.arange(first, self._frames + 1) % self.KEPT
        later = self.onset > np.minimum.reduce(self.onset[self.onset >= 0])
        rows = (begins & later).nonzero()[0]
        if len(rows):
            past, onset = self._position[order[:, None], rows], self.onset[rows] - first
            motion = (onset, self._reference[rows], self._gauge, self._border.select(order))
            self._by_motion[rows] |= _entered_by_motion(past, np.arange(len(rows)), *motion)
        kept = self.onset - EntryGradients.BEFORE > self._frames - self.KEPT  # those of which the entry is known
        extended = extend_to_neighbours(self._by_motion, self._seeded, later, NEAR * self._gauge)
        self.entered = extended & (self.entered | kept)
