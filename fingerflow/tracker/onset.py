"""Determine the onset of contact: frame and position at which each skin point first touches the glass."""

from typing import NamedTuple

import numpy as np

from fingerflow.kernels.array_types import Array
from fingerflow.kernels.arrays import is_finite, squared_distances
from fingerflow.kernels.result_records import FrameEllipse

#: Number of consecutive frames in which the contact must cover a point for a lasting touch.
LASTING = 3
_NO_PAIR = complex(np.nan, np.nan)
_NEAREST = 4  # number of previous points from which a new one takes its displacement, weighted by distance


class Touching(NamedTuple):
    """Current touch of each of N points in F frames: position and time at which it began; NaN without a touch.

    Attributes:
        position: (F, N, 2) mm, position of the point when its touch began, interpolated between two frames.
        share: (F, N) fraction of the step from the previous frame to the first frame of the touch at which it began.
        variance, earlier: (F, N) px^2, variance of the point in the first frame of its touch, and in the frame before,
            the latter 0 if unknown.
        touching, begins: (F, N) bool, whether a point has a touch, and whether it begins in this frame.
    """

    position: Array
    share: Array
    variance: Array
    earlier: Array
    touching: Array
    begins: Array


class Touches:
    """Touch history of all points: whether each point touches the glass, and when and where its touch began.

    It is updated as frames are added.

    A touch shorter than `LASTING` frames is discarded: whether the border grazes a point is chance, and the skin keeps
    moving until the contact lasts. A lasting touch is kept, even if the contact leaves the point later.

    A touch begins when the border of the apparent contact passes the point between two frames: on average half a frame
    before the first frame that shows it.

    Attributes:
        length: (N,) consecutive frames in which the contact has covered each point; it stays at `LASTING` once reached.
        start: (N,) number of the frame in which the latest touch began, -1 before the first.
        position, share, variance, earlier: (N, ...) of the present touch, as for `Touching`.
        first, first_position: number of the frame and position of the very first touch, which may not have lasted.
    """

    def __init__(self, points: int) -> None:
        self.points = points
        self.length = np.zeros(points, np.uint8)
        self.start = np.full(points, -1)
        self.position = np.full((points, 2), np.nan)
        self.share, self.variance, self.earlier = np.full((3, points), np.nan, np.float32)
        self.first = np.full(points, -1)
        self.first_position = np.full((points, 2), np.nan)
        # Positions, variances and border in the previous frame.
        self._before, self._variance_before = np.full((1, points, 2), np.nan), np.zeros((1, points), np.float32)
        self._border_before = FrameEllipse(np.full((1, 2), np.nan), np.full((1, 2), np.nan), np.full(1, np.nan))

    def replace(self, points: Array, position: Array) -> None:
        """Give points (n,), indices, a lasting touch that began at `position` (n, 2) mm; NaN for no touch, so that the
        next frame in contact begins one.
        """
        known = np.isfinite(position).all(1)
        self.length[points], self.position[points] = np.where(known, LASTING, 0), position
        self.share[points] = np.where(known, 1, np.nan)
        self.variance[points] = self.earlier[points] = np.where(known, 0, np.nan)

    def add_frames(
        self, frames: Array, covered: Array, position: Array, variance: Array, border: FrameEllipse
    ) -> Touching:
        """Add F frames in order of time, and return for each frame and point whether the point touches the glass, and
        where and when its present touch began.

        Args:
            frames: (F,) numbers of the frames.
            covered: (F, N) whether the contact covers each point.
            position: (F, N, 2) mm, NaN where lost.
            variance: (F, N) px^2 of a component.
            border: of the apparent contact.
        """
        steps, goes_on = len(frames), self.length > 0
        before, borders, variances = self._before, self._border_before, self._variance_before
        self._before, self._variance_before = position[-1:].copy(), variance[-1:].copy()
        self._border_before = border if steps == 1 else border.select(slice(-1, None))
        touching, begins = goes_on[None].repeat(steps, axis=0), np.zeros((steps, self.points), dtype=bool)
        # Of points without a touch these are NaN.
        start_position, share, spread, earlier = [
            values[None].repeat(steps, axis=0) for values in (self.position, self.share, self.variance, self.earlier)
        ]
        # Skip the points with a lasting touch and those out of contact in all of these frames, which are most.
        active = ((self.length < LASTING) & (goes_on | np.logical_or.reduce(covered))).nonzero()[0]
        if not len(active):
            return Touching(start_position, share, spread, earlier, touching, begins)
        before, variances = np.concatenate((before, position)), np.concatenate((variances, variance))
        borders = FrameEllipse(*[np.concatenate(pair) for pair in zip(borders, border, strict=True)])
        number = np.arange(1, steps + 1, dtype=np.int32)[:, None]
        # For points without a lasting touch: number of frames since the last one without contact.
        left = np.maximum.accumulate(number * (covered[:, active] == 0), axis=0)
        length = number - left + (left == 0) * self.length[active]
        length[np.logical_or.accumulate(length >= LASTING, axis=0)] = LASTING
        length = length.astype(np.uint8)
        begin = (length == 1) & (np.concatenate((self.length[None, active], length[:-1])) == 0)
        touching[:, active], begins[:, active] = length > 0, begin
        at_border, passed = _border_crossings(before, borders, begins)
        came = (np.logical_or.reduce(begin) & (self.first[active] < 0)).nonzero()[0]
        first, points = begin[:, came].argmax(0), active[came]
        self.first[points], self.first_position[points] = frames[first], at_border[first, points]
        began = np.maximum.accumulate(number * begin, axis=0)
        here, new, at = length > 0, began > 0, np.maximum(began - 1, 0)
        at = at * self.points + active
        for values, new_values, none in (
            # As complex numbers, since NumPy takes several times as long over an axis of two.
            (start_position.view(np.complex128)[..., 0], at_border.view(np.complex128)[..., 0], _NO_PAIR),
            (share, passed, np.float32(np.nan)),
            (spread, variance, np.float32(np.nan)),
            (earlier, np.where(np.isnan(variances[:-1]), np.float32(0), variances[:-1]), np.float32(np.nan)),
        ):
            part = values[:, active]
            part[new] = new_values.ravel()[at[new]]
            part[~here] = none
            values[:, active] = part
        self.start[active[new[-1]]] = frames[began[-1][new[-1]] - 1]
        self.length[active], self.position = length[-1], start_position[-1].copy()
        self.share, self.variance, self.earlier = share[-1].copy(), spread[-1].copy(), earlier[-1].copy()
        return Touching(start_position, share, spread, earlier, touching, begins)


def interpolate_displacement(
    before: Array, moved: Array, points: Array, fewest: int, reach: float = np.inf
) -> tuple[Array, Array]:
    """Return the displacements (N, 2) of newly seeded points, interpolated from those of the nearest previous points,
    and the variance (N,) of a component among these; NaN if fewer than `fewest` previous points are known, or none
    within `reach` px.

    Args:
        before: (M, 2) px, previous points in the frame of the seeding, NaN where lost.
        moved: (M, 2) their displacements in any unit, NaN where not known.
        points: (N, 2) px, the new points; NaN for none.
    """
    displacement, variance = np.full(points.shape, np.nan), np.full(len(points), np.nan)
    known, new = np.isfinite(before + moved).all(-1), np.isfinite(points).all(-1)
    if known.sum() >= max(fewest, _NEAREST):
        distance = squared_distances(points[new], before[known])
        nearest = np.argpartition(distance, _NEAREST - 1, axis=1)[:, :_NEAREST]
        distance[distance.min(1) > reach**2] = np.nan
        weight = 1 / (np.take_along_axis(distance, nearest, axis=1) + 1)[..., None]
        values, total = moved[known][nearest], weight.sum(1)
        displacement[new] = (weight * values).sum(1) / total
        variance[new] = ((weight * np.square(values - displacement[new, None])).sum(1) / total).mean(1)
    return displacement, variance


def _border_crossings(position: Array, border: FrameEllipse, begins: Array) -> tuple[Array, Array]:
    """Interpolate, for each point whose touch begins in a frame (`begins`, (F, N) bool), where (mm) and when, since the
    frame before, the contact border passed it.

    Return positions (F, N, 2) mm and shares (F, N). The first of the positions (F + 1, N, 2) and of the borders belongs
    to the frame before. A share is the fraction of the step from the previous frame at which the border passed the
    point: depth inside the ellipse is interpolated linearly between both frames. Where the depth grows and the ellipse
    is not crossed between them, the nearer end of the step is taken. Where it does not grow, the ellipse does not tell
    when the border passed: then, and without an ellipse in the previous frame, the middle of the step is taken. For a
    point that was lost there, it is its position now.
    """
    share = np.ones(begins.shape, np.float32)
    frame, point = begins.nonzero()
    if not len(frame):
        return position[1:], share
    now, before = position[frame + 1, point], position[frame, point]
    inside = border.select(np.concatenate((frame, frame + 1))).inside(np.concatenate((before, now))[:, None])[:, 0]
    outside, inside = inside[: len(frame)], inside[len(frame) :]
    passed = np.full(len(frame), 0.5)
    np.divide(outside, outside - inside, out=passed, where=inside > outside)
    passed = np.minimum(np.maximum(passed, 0), 1)
    valid = is_finite(before)
    share[frame, point] = np.where(valid, passed, 1)
    positions = position[1:].copy()
    positions[frame[valid], point[valid]] += (passed[valid, None] - 1) * (now - before)[valid]
    return positions, share
