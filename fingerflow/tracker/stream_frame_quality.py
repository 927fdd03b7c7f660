"""Frame quality in a stream: detection of invalid images, without knowledge of later frames.

Recordings are checked with later frames (`tracker.frame_returns`), where the limits common to both are defined.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fingerflow.schema.variables import DARK_SHARE, FRAME_STATUS, SATURATED_SHARE
from fingerflow.tracker.block_means import block_means
from fingerflow.tracker.frame_distances import LONGEST, divide_by_mean, row_distances
from fingerflow.tracker.frame_returns import FAR, REPEATED_SHARE

Array = NDArray[Any]

USABLE = FRAME_STATUS.index("usable")
_DARK, _SATURATED, _REPEATED, _JUMPS = (
    FRAME_STATUS.index(name) for name in ("dark", "saturated", "repeated", "jumps_and_returns")
)
MEASURED = (USABLE, _JUMPS)  # statuses, by itself, of a frame in which points are tracked
# A frame is far at so many times the steps before, and at least this share of the light; slipping skin has 0.07.
_FAR, _LEAST = 3.0, 0.03
_LOST = 0.25  # share of the points of the frame before that must be lost at once
_FEWEST = 8  # points, below which lost ones are not counted
_LIGHT, _FEWEST_BLOCKS = 0.15, 16  # change of light (its logarithm) over nine tenths of at least so many blocks
_STEPS = 8  # latest steps between usable frames that are kept
_RETURNS = 2  # jumps and returns in the last `_RECENT` frames, from which on the finger vibrates
_KNOWN, _RECENT = 8, 16  # frames
_LIT = 0.3  # of the mean light: lines of the empty glass with less are not checked
_FLICKER, _CHANGES = 8, 16  # changes of light, in so many frames, from which on the lamp flickers: its frames count


class Blocks(NamedTuple):
    """Block means of a frame, for comparison with other frames.

    Attributes:
        means: (views, rows, columns).
        even: (rows of all views, columns), means over that of each view, independent of the lamp.
        light: (blocks,) logarithm of the means of the contact view.
    """

    means: Array
    even: Array
    light: Array


class FrameCheck:
    """Detection of invalid frames of a stream, by brightness and by comparison with the last usable frame.

    - Dark or saturated: detected from the frame alone, with the limits of `process`.
    - Lost lines: lines of the contact view without light.
    - Far from the last usable frame: from another moment, torn or shifted. Points must be lost with it that are not
      found elsewhere, as they are after a jump of the skin.
    - Lamp: nine tenths of the contact view become lighter or darker at once; a contact never covers all of it. If the
      lamp flickers, this happens again and again, and its frames count.
    - Repeated: all block means equal those of the frame before. This is detected once more than eight frames were
      compared, and only if no more than a fifth of the last frames repeat.

    A far frame whose points are found is from another moment, or the skin jumps. It is deferred, and the next frame
    decides. After two returns in the last 16 frames a finger is taken to vibrate, and such frames count.

    `process` also knows later frames, a stream does not: a state that lasts for more than `LONGEST` frames is taken as
    the new one, and its first `LONGEST` frames do not count.

    Args:
        glass, dark: (H, W) contact view of the empty glass, and without light.
        bit_depth: of the frames.
    """

    def __init__(self, glass: Array, dark: Array, bit_depth: int) -> None:
        self._black = float(_blocks(dark)[0].mean())
        empty, lines = _blocks(glass)
        self._lit = lines - self._black > _LIT * (lines.mean() - self._black)
        self._least = self._black + DARK_SHARE * (float(empty.mean()) - self._black)
        self._top = 2**bit_depth - 1.5
        self._tells_saturated = float((empty > self._top).mean()) < SATURATED_SHARE
        self._last: Blocks | None = None
        self._doubtful: _DeferredStep | None = None
        self._returned: deque[bool] = deque(maxlen=_RECENT)  # whether frames jumped and returned
        self._number = self._tracked = self._jumped = 0
        self._lacks_lines = False
        self._before: deque[float] = deque(maxlen=_STEPS)
        self._previous: Blocks | None = None  # blocks of the frame before, whether it counts or not
        self._same: deque[bool] = deque(maxlen=_RECENT)  # whether frames equalled the one before
        self._changes: deque[bool] = deque(maxlen=_CHANGES)  # whether light changed by more than half of the limit

    def look(self, views: Mapping[str, Array]) -> tuple[Blocks, int]:
        """Compute the block means of all views (1, 1, H, W), and the frame status from this frame alone.

        Any thread may call it.
        """
        (contact, lines), *others = (_blocks(views[name][0, 0]) for name in sorted(views))  # the contact view is first
        every = [contact, *(one for one, _ in others)]
        means = np.stack(every)
        even = divide_by_mean(means).reshape(-1, contact.shape[1])
        blocks = Blocks(means, even, np.log(np.maximum(contact, 1).ravel()))
        if float(contact.mean()) < self._least:
            return blocks, _DARK
        if self._tells_saturated and float((contact > self._top).mean()) > SATURATED_SHARE:
            return blocks, _SATURATED
        return blocks, _JUMPS if (self._lit & (lines < self._least)).any() else USABLE

    def see(self, number: int, blocks: Blocks, status: int, tracked: int, elsewhere: bool) -> int | None:
        """Determine the status of a frame by comparison with earlier frames; None while this waits for the next frame.

        `settle` must then be called before the next frame is added.

        Args:
            number: of the frame.
            blocks, status: results of `look`.
            tracked: number of points found in it.
            elsewhere: whether many were found far from where their motion leads (`tracker.points.Resolved`).
        """
        if status not in (USABLE, _JUMPS):
            return status
        step, light, change = 0.0, 0.0, 0.0
        previous = self._previous
        if previous is not None:
            same = np.array_equal(blocks.means, previous.means)
            self._same.append(same)
            change = _change_of_light(blocks, previous)
            self._changes.append(change > _LIGHT / 2)
            if same and len(self._same) > _KNOWN and sum(self._same) <= REPEATED_SHARE * len(self._same):
                return _REPEATED
        self._previous = blocks
        lacks_lines = status == _JUMPS and not self._lacks_lines
        if self._last is not None:
            # The motion during frames that were dropped or did not count adds up.
            gap = max(1, min(number - self._number, LONGEST + 1))
            step = float(_steps(blocks, self._last).max())
            if sum(self._changes) < _FLICKER:
                light = change if self._last is previous else _change_of_light(blocks, self._last)
            usual = max(self._before, default=_LEAST)
            lost = self._tracked >= _FEWEST and tracked < (1 - _LOST) * self._tracked and not elsewhere
            far = step > max(_LEAST, _FAR * gap * usual)
            if ((far and lost) or lacks_lines or light > _LIGHT) and self._jumped < LONGEST:
                self._jumped += 1
                return _JUMPS
            if far and not self._jumped:
                self._doubtful = _DeferredStep(number, blocks, tracked, step / gap, usual)
                return None
            if not self._jumped:
                self._before.append(step / gap)
        self._returned.append(False)
        self._last, self._number, self._tracked, self._jumped = blocks, number, tracked, 0
        self._lacks_lines = status == _JUMPS
        return USABLE

    def settle(self, following: Blocks | None) -> int:
        """Determine the status of the deferred frame by comparison with the frame that follows it.

        Args:
            following: block means of the next frame; None if there is none or it is not usable.
        """
        one, self._doubtful = self._doubtful, None
        assert one is not None
        assert self._last is not None
        if following is not None and sum(self._returned) < _RETURNS:
            away = np.minimum(_steps(one.blocks, self._last), _steps(following, one.blocks))
            if (away > FAR * np.maximum(_steps(following, self._last), one.usual)).any():
                self._returned.append(True)
                return _JUMPS
        self._returned.append(False)
        self._before.append(one.step)
        self._last, self._number, self._tracked = one.blocks, one.number, one.tracked
        return USABLE


def _blocks(view: Array) -> tuple[Array, Array]:
    """Return the block means (rows, columns) of a view (H, W), and the means of the sampled lines."""
    blocks, lines = block_means(view[None])
    return blocks[0], lines[0]


class _DeferredStep(NamedTuple):
    """Deferred frame, with its image distance from the last usable frame, and the largest recent image distance."""

    number: int
    blocks: Blocks
    tracked: int
    step: float
    usual: float


def _steps(blocks: Blocks, before: Blocks) -> Array:
    """Return the image distance of a frame from an earlier frame, for each row of blocks of all views.

    It is relative to the mean of each view.
    """
    rows: Array = row_distances(blocks.even[None], before.even[None])[0]
    return rows


def _change_of_light(blocks: Blocks, before: Blocks) -> float:
    """Return the change of light shared by nine tenths of the blocks: the smallest |log ratio| among these blocks.

    All of these blocks became lighter, or all became darker.
    """
    count = blocks.light.size
    if count < _FEWEST_BLOCKS:
        return 0.0
    change = np.sort(blocks.light - before.light)
    place, share = divmod(0.1 * (count - 1), 1)  # quantiles interpolated as by NumPy, which takes ten times as long
    low, high = int(place), count - 1 - int(place)
    lightest = change[low] + share * (change[low + 1] - change[low])
    darkest = change[high] + share * (change[high - 1] - change[high])
    return float(max(lightest, -darkest, 0.0))
