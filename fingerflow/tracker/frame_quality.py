"""Which frames are pictures of the trial: what a stream can tell of a frame without those to come.

A recording knows these, and tells by them (`tracker.frame_returns`); limits that both have stand once.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fingerflow.schema.variables import DARK_SHARE, FRAME_STATUS, SATURATED_SHARE
from fingerflow.tracker.block_means import block_means
from fingerflow.tracker.frame_distances import LONGEST, evened, row_distances
from fingerflow.tracker.frame_returns import FAR, REPEATED_SHARE

Array = NDArray[Any]

USABLE = FRAME_STATUS.index("usable")
_DARK, _SATURATED, _REPEATED, _JUMPS = (
    FRAME_STATUS.index(name) for name in ("dark", "saturated", "repeated", "jumps_and_returns")
)
MEASURED = (USABLE, _JUMPS)  # statuses by itself of a frame in which points are looked for
_FAR, _LEAST = 3.0, 0.03  # times the steps before, and of the light of a row of blocks; skin that slips moves 0.07
_LOST = 0.25  # of the points of the frame before, at once
_FEWEST = 8  # points, below which their number says nothing
_LIGHT, _FEWEST_BLOCKS = 0.15, 16  # change of light (its logarithm) over nine tenths of at least so many blocks
_STEPS = 8  # between usable frames that are remembered
_RETURNS = 2  # in so many frames, beyond which they are the finger's
_KNOWN, _RECENT = 8, 16  # frames
_LIT = 0.3  # of the glass's light, that a line of the empty glass has at least
_FLICKER, _CHANGES = 8, 16  # changes of light, of so many frames, that are a lamp that flickers: its frames count


class Blocks(NamedTuple):
    """Block means of a frame, by which it is compared with others.

    Attributes:
        means: (views, rows, columns).
        even: (rows of all views, columns), over the mean of each view: whatever the lamp does.
        light: (blocks,) logarithm of the means of the contact view.
    """

    means: Array
    even: Array
    light: Array


class FrameCheck:
    """Tells frames that cannot be from their own light, and from the last usable frame.

    A dark or saturated frame is known by itself, with the limits of `process`. A frame far from the last usable one
    has come from another moment, is torn or shifted, where points are lost with it and are not to be
    found elsewhere, as after a jump of the skin; where nine tenths of the contact
    view become lighter or darker at once, it is the lamp: a contact never covers all of it. One that flickers does so
    again and again, and its frames count. Lines of the contact view without light have been lost. `process` knows the
    frames behind a frame too, a stream does not: what stays
    for more than `LONGEST` frames is taken for the new state, and of one that stays the first `LONGEST` frames do not
    count. A far frame whose points are found may be of another moment, or skin that jumps: the next frame says which,
    and it waits for that. Where more than a tenth of the last frames came back, a finger vibrates, and they count. A
    frame of which all block means are those of the one before is told once eight frames have come that differ, and
    where no more than a fifth does so.

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
        self._doubtful: _DoubtfulStep | None = None
        self._returned: deque[bool] = deque(maxlen=_RECENT)  # whether frames were there and back
        self._number = self._tracked = self._jumped = 0
        self._lacks_lines = False
        self._before: deque[float] = deque(maxlen=_STEPS)
        self._previous: Blocks | None = None  # blocks of the frame before, whether it counts or not
        self._same: deque[bool] = deque(maxlen=_RECENT)  # whether frames were the one before
        self._changes: deque[bool] = deque(maxlen=_CHANGES)  # of its light, by more than half of the limit

    def look(self, views: Mapping[str, Array]) -> tuple[Blocks, int]:
        """Block means of each view (1, 1, H, W), and the status that a frame has by itself; in any thread."""
        (contact, lines), *others = (_blocks(views[name][0, 0]) for name in sorted(views))  # the contact view is first
        every = [contact, *(one for one, _ in others)]
        means = np.stack(every)
        even = evened(means).reshape(-1, contact.shape[1])
        blocks = Blocks(means, even, np.log(np.maximum(contact, 1).ravel()))
        if float(contact.mean()) < self._least:
            return blocks, _DARK
        if self._tells_saturated and float((contact > self._top).mean()) > SATURATED_SHARE:
            return blocks, _SATURATED
        return blocks, _JUMPS if (self._lit & (lines < self._least)).any() else USABLE

    def see(self, number: int, blocks: Blocks, status: int, tracked: int, elsewhere: bool) -> int | None:
        """The status of a frame, in their order; None where `settle` is to say it, before the next frame is seen.

        Args:
            number: of the frame.
            blocks, status: of `look`.
            tracked: points found in it.
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
            # The motion of frames that were dropped or did not count comes on top.
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
                self._doubtful = _DoubtfulStep(number, blocks, tracked, step / gap, usual)
                return None
            if not self._jumped:
                self._before.append(step / gap)
        self._returned.append(False)
        self._last, self._number, self._tracked, self._jumped = blocks, number, tracked, 0
        self._lacks_lines = status == _JUMPS
        return USABLE

    def settle(self, following: Blocks | None) -> int:
        """The status of the frame of which `see` could not say it.

        Args:
            following: block means of the next frame; None where there is none, or none that could count.
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
    """Block means (rows, columns) of a view (H, W), and the means of the lines that are read."""
    blocks, lines = block_means(view[None])
    return blocks[0], lines[0]


class _DoubtfulStep(NamedTuple):
    """A frame of which the next one says whether it counts, its step a frame, and what is usual."""

    number: int
    blocks: Blocks
    tracked: int
    step: float
    usual: float


def _steps(blocks: Blocks, before: Blocks) -> Array:
    """How far each row of blocks, of all views, is from that before, over the light of its frame."""
    rows: Array = row_distances(blocks.even[None], before.even[None])[0]
    return rows


def _change_of_light(blocks: Blocks, before: Blocks) -> float:
    """By how much nine tenths of the blocks at least have become lighter, or darker: logarithm of the quotient."""
    count = blocks.light.size
    if count < _FEWEST_BLOCKS:
        return 0.0
    change = np.sort(blocks.light - before.light)
    place, share = divmod(0.1 * (count - 1), 1)  # quantiles, as NumPy interpolates them: it takes ten times as long
    low, high = int(place), count - 1 - int(place)
    lightest = change[low] + share * (change[low + 1] - change[low])
    darkest = change[high] + share * (change[high - 1] - change[high])
    return float(max(lightest, -darkest, 0.0))
