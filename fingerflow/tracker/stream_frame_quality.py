"""Frame quality in a stream: detection of invalid images by the rules of a recording, as far as frames have arrived."""

from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from fingerflow.kernels.array_types import Array
from fingerflow.schema.variables import DARK, JUMPS, REPEATED, SATURATED, USABLE
from fingerflow.tracker import frame_copies
from fingerflow.tracker.block_means import PictureCheck
from fingerflow.tracker.frame_distances import LONGEST, PixelSamples, squared_distances
from fingerflow.tracker.frame_jumps import NEARBY, Ordinary, excess, is_far, is_jump, ordinary_limit, ordinary_values

_STEPS = 64  # number of latest steps between usable frames from which ordinary steps are estimated
_REMEMBERED = 512  # number of latest usable frames with which a frame is compared to detect a copy
_RETURNS = 3  # number of jumps and returns in the last `_RECENT` frames from which on the finger counts as vibrating
_KNOWN = 8  # frames after which repetitions are judged
_RECENT = 16  # frames over which they are counted
_LIT = 0.3  # share of the mean light: lines of the empty glass with less are not checked


class Picture(NamedTuple):
    """Frame under comparison: its status as determined from the frame alone, sampled pixels of its views, the contact
    view first, the hashes by which exact copies are recognised (`frame_copies.frame_key`), and the number of the frame.
    """

    status: int
    samples: PixelSamples
    key: frame_copies.FrameKey
    number: int

    def squared_distance(self, before: "Picture") -> Array:
        """Return the squared image distances (rows,) of this frame from an earlier one, the rows of all views in
        sequence.
        """
        return squared_distances(self.samples, before.samples).ravel()


class FrameCheck:
    """Detection of invalid frames of a stream, by brightness and by comparison with the last usable frame.

    - Dark or saturated: detected from the frame alone, with the limits of `process`.
    - Noise, lines or blocks in disorder (`block_means.is_noise`), in the contact view, however long it lasts.
    - Lost lines: lines of the contact view without light, in up to `LONGEST` frames in a row; then it is the camera's.
    - Repeated: a view repeats the picture before while the other changes, or the frame equals one of the last 512 that
      count. The latter is detected once more than eight frames were compared, and only if no more than a fifth of the
      last frames repeat others.
    - Jumps and returns: the rule of a recording (`frame_jumps.is_jump`). A frame far from the last usable one is
      deferred, with those behind it, until the image returns or `LONGEST` frames have passed: then it counts, as the
      motion of the skin, or a change that stays, and those behind it are judged anew. After three returns in the last
      16 frames a finger is taken to vibrate, and such frames count. Frames deferred at the end do not count.

    `process` also knows later frames: the motion behind a jump, and which of two equal frames is the copy.

    Args:
        glass, dark: (H, W) contact view of the empty glass, and without light.
        bit_depth: of the frames.

    Attributes:
        stale_views: frames in which a view repeats its picture.
    """

    def __init__(self, glass: Array, dark: Array, bit_depth: int) -> None:
        self._alone = PictureCheck(glass, dark, bit_depth)
        lines = self._alone.lines - self._alone.black
        self._lit = lines > _LIT * lines.mean()
        self._last: Picture | None = None  # latest usable frame
        self._without_lines = 0  # number of consecutive frames with dark lines
        self._deferred: list[Picture] = []
        self._steps: deque[Array] = deque(maxlen=_STEPS)
        self._returned: deque[bool] = deque(maxlen=_RECENT)  # whether the latest frames jumped and returned
        self._keys: deque[frame_copies.FrameKey] = deque(maxlen=_REMEMBERED)
        self.stale_views = frame_copies.StaleViews()
        self._same: deque[bool] = deque(maxlen=_RECENT)  # whether the latest frames equalled an earlier one

    def inspect(self, number: int, views: Mapping[str, Array]) -> Picture:
        """Sample all views (1, 1, H, W), of one size, of the frame with this number, and determine its status from the
        frame alone.

        Any thread may call it.
        """
        images = [views[name][0] for name in sorted(views)]  # sorted names put the contact view first
        alone = self._alone.inspect(images)
        status, unlit = int(alone.status[0]), self._lit & (alone.lines < self._alone.least)
        if status not in (DARK, SATURATED) and np.logical_or.reduce(unlit, None):
            status = JUMPS
        return Picture(status, PixelSamples.of(*alone.pixels), alone.keys[0], number)

    def update(self, picture: Picture) -> list[int]:
        """Determine the status of a frame, given as the result of `inspect`, by comparison with earlier frames; return
        the statuses that are thereby decided, in order: of the first deferred frames, and of this frame unless it is
        deferred itself.
        """
        status = picture.status
        self._without_lines = self._without_lines + 1 if status == JUMPS else 0
        if self._without_lines > LONGEST:
            status = USABLE
        stale = self.stale_views.update(picture.key)  # of every frame, as in a recording
        if status == USABLE and (stale or self._repeats(picture.key)):
            status = REPEATED
        return self._judged(picture._replace(status=status))

    def _judged(self, frame: Picture) -> list[int]:
        if not self._deferred:
            if frame.status != USABLE:
                return [frame.status]
            step = self._step_to(frame)
            if self._is_far(frame, step):
                self._deferred.append(frame)
                return []
            self._count(frame, step)
            return [USABLE]
        if frame.status == USABLE and self._comes_back(frame):
            self._returned.append(True)
            decided = self.settle()
            self._count(frame, self._step_to(frame))
            return [*decided, USABLE]
        if frame.number - self._deferred[0].number < LONGEST:
            self._deferred.append(frame)
            return []
        # The image does not return, so the first deferred frame is usable; the frames behind it are judged again.
        first, *rest = self._deferred
        self._deferred = []
        self._count(first, self._step_to(first))
        decided = [USABLE]
        for later in (*rest, frame):
            decided += self._judged(later)
        return decided

    def settle(self) -> list[int]:
        """Decide that none of the deferred frames is usable, and return their statuses: their own fault, or else a jump
        of the image.
        """
        deferred, self._deferred = self._deferred, []
        return [JUMPS if frame.status == USABLE else frame.status for frame in deferred]

    def finish(self) -> list[int]:
        """Return the statuses of frames that are deferred at the end of the stream.

        They do not count, unless too few steps are known to tell what is usual.
        """
        return [frame.status for frame in self._deferred] if len(self._steps) < NEARBY else self.settle()

    def _repeats(self, key: frame_copies.FrameKey) -> bool:
        same = key in self._keys
        self._same.append(same)
        return same and len(self._same) > _KNOWN and sum(self._same) <= frame_copies.REPEATED_SHARE * len(self._same)

    def _step_to(self, frame: Picture) -> Array | None:
        """Return the squared distance (rows,) of a frame from the last usable one; None if there is none."""
        return None if self._last is None else frame.squared_distance(self._last)

    def _count(self, frame: Picture, step: Array | None) -> None:
        """Record a usable frame as the latest one; `step` is its squared distance (rows,) from the usable frame before,
        None if there is none.
        """
        if self._last is not None and step is not None and frame.number == self._last.number + 1:
            self._steps.append(step)
        self._returned.append(False)
        self._keys.append(frame.key)
        self._last = frame

    def _is_far(self, frame: Picture, step: Array | None) -> bool:
        """Return whether the squared distance `step` (rows,) of a frame from the last usable one is so large that the
        image may have jumped.
        """
        if self._last is None or step is None or not self._steps or sum(self._returned) >= _RETURNS:
            return False
        usual, gap = self._usual(), frame.number - self._last.number
        # Check first without the excesses of other frames, which take longer to compute; few frames are so far.
        return is_far(step, gap, usual) and is_far(step, gap, usual, self._ordinary())

    def _comes_back(self, frame: Picture) -> bool:
        """Return whether the image has jumped away in the deferred frames and returns, with this frame, to that of the
        last usable one.
        """
        assert self._last is not None
        if frame.number - self._last.number > LONGEST + 1:
            return False
        first, *rest = [step_frame for step_frame in self._deferred if step_frame.status == USABLE]
        into, latest, within = first.squared_distance(self._last), first, np.zeros_like(self._steps[0])
        for step_frame in rest:
            within, latest = np.maximum(within, step_frame.squared_distance(latest)), step_frame
        out_of, between = (frame.squared_distance(step_frame) for step_frame in (latest, self._last))
        return is_jump(into, out_of, between, within, self._usual(), self._ordinary())

    def _usual(self) -> Array:
        """Return the squared image distance (rows,) that is usual between consecutive frames at present: the larger of
        the latest one and the `ordinary_limit` of recent ones.
        """
        steps = np.array([*self._steps][-NEARBY:])
        return np.maximum(ordinary_limit(steps, axis=0) if len(steps) == NEARBY else steps.max(0), steps[-1])

    def _ordinary(self) -> Ordinary:
        steps = np.stack(self._steps)
        return ordinary_values(steps, excess(steps[1:-1], steps[2:], steps[:-2]))
