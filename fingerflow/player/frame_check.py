"""Which frames are pictures of the trial: what a stream can tell of a frame without the ones to come."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from .arrays import Array
from .contract.variables import DARK_SHARE, FRAME_STATUS, SATURATED_SHARE

USABLE = FRAME_STATUS.index("usable")
_DARK, _SATURATED, _REPEATED, _JUMPS = (
    FRAME_STATUS.index(name) for name in ("dark", "saturated", "repeated", "jumps_and_returns")
)
# As `fingerflow.ops.frame_distances` has them: blocks wider than ridges, some 20,000 pixels read.
_BLOCK_PX, _BLOCKS, _SAMPLES = 24, 16, (128, 160)
LONGEST = 3  # frames in a row that may jump: a picture that stays for a fourth is the new state of the trial
_THERE_AND_BACK = 4.0  # times as far from both neighbours as these are from each other, as `process` has it
_FAR, _LEAST = 3.0, 0.03  # times the steps before, and of the light of a row of blocks; skin that slips moves 0.07
_LOST = 0.25  # of the points of the frame before, at once
_FEWEST = 8  # points, below which their number says nothing
_LIGHT, _FEWEST_BLOCKS = 0.15, 16  # change of light (its logarithm) over nine tenths of at least so many blocks
_STEPS = 8  # between usable frames that are remembered
_RETURNS = 2  # in so many frames, beyond which they are the finger's
_KNOWN, _RECENT, _REPEATED_SHARE = 8, 16, 0.2  # frames; beyond that share of them the camera gives fewer than it says
_LIT = 0.3  # of the glass's light, that a line of the empty glass has at least
_FLICKER, _CHANGES = 8, 16  # changes of light, of so many frames, that are a lamp that flickers: its frames count


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
        self._rows, self._columns = (_means(side, most) for side, most in zip(glass.shape, _SAMPLES, strict=True))
        self._black = float(self._blocks(dark).mean())
        empty, lines = self._blocks(glass), self._lines(glass)
        self._lit = lines - self._black > _LIT * (lines.mean() - self._black)
        self._least = self._black + DARK_SHARE * (float(empty.mean()) - self._black)
        self._top = 2**bit_depth - 1.5
        self._tells_saturated = float((empty > self._top).mean()) < SATURATED_SHARE
        self._last: dict[str, Array] | None = None
        self._doubtful: _Doubtful | None = None
        self._returned: deque[bool] = deque(maxlen=_RECENT)  # whether frames were there and back
        self._number = self._tracked = self._jumped = 0
        self._lacks_lines = False
        self._before: deque[float] = deque(maxlen=_STEPS)
        self._previous: dict[str, Array] | None = None  # blocks of the frame before, whether it counts or not
        self._same: deque[bool] = deque(maxlen=_RECENT)  # whether frames were the one before
        self._changes: deque[bool] = deque(maxlen=_CHANGES)  # of its light, by more than half of the limit

    def look(self, views: Mapping[str, Array]) -> tuple[dict[str, Array], int]:
        """Block means of each view (1, 1, H, W), and the status that a frame has by itself; in any thread."""
        blocks = {name: self._blocks(view[0, 0]) for name, view in views.items()}
        contact = blocks["contact_view"]
        if float(contact.mean()) < self._least:
            return blocks, _DARK
        if self._tells_saturated and float((contact > self._top).mean()) > SATURATED_SHARE:
            return blocks, _SATURATED
        if (self._lit & (self._lines(views["contact_view"][0, 0]) < self._least)).any():
            return blocks, _JUMPS
        return blocks, USABLE

    def see(self, number: int, blocks: dict[str, Array], status: int, tracked: int, elsewhere: bool) -> int | None:
        """The status of a frame, in their order; None where `settle` is to say it, before the next frame is seen.

        Args:
            number: of the frame.
            blocks, status: of `look`.
            tracked: points found in it.
            elsewhere: whether many were found far from where their motion leads (`SecondLook`).
        """
        if status not in (USABLE, _JUMPS):
            return status
        step, light = 0.0, 0.0
        contact, previous = blocks["contact_view"], self._previous
        if previous is not None:
            same = all(np.array_equal(blocks[name], previous[name]) for name in blocks)
            self._same.append(same)
            self._changes.append(_change_of_light(contact, previous["contact_view"]) > _LIGHT / 2)
            if same and len(self._same) > _KNOWN and sum(self._same) <= _REPEATED_SHARE * len(self._same):
                return _REPEATED
        self._previous = blocks
        lacks_lines = status == _JUMPS and not self._lacks_lines
        if self._last is not None:
            # The motion of frames that were dropped or did not count comes on top.
            gap = max(1, min(number - self._number, LONGEST + 1))
            step = float(_steps(blocks, self._last).max())
            if sum(self._changes) < _FLICKER:
                light = _change_of_light(contact, self._last["contact_view"])
            usual = max(self._before, default=_LEAST)
            lost = self._tracked >= _FEWEST and tracked < (1 - _LOST) * self._tracked and not elsewhere
            far = step > max(_LEAST, _FAR * gap * usual)
            if ((far and lost) or lacks_lines or light > _LIGHT) and self._jumped < LONGEST:
                self._jumped += 1
                return _JUMPS
            if far and not self._jumped:
                self._doubtful = _Doubtful(number, blocks, tracked, step / gap, usual)
                return None
            if not self._jumped:
                self._before.append(step / gap)
        self._returned.append(False)
        self._last, self._number, self._tracked, self._jumped = blocks, number, tracked, 0
        self._lacks_lines = status == _JUMPS
        return USABLE

    def settle(self, following: dict[str, Array] | None) -> int:
        """The status of the frame of which `see` could not say it.

        Args:
            following: block means of the next frame; None where there is none, or none that could count.
        """
        one, self._doubtful = self._doubtful, None
        assert one is not None
        assert self._last is not None
        if following is not None and sum(self._returned) < _RETURNS:
            away = np.minimum(_steps(one.blocks, self._last), _steps(following, one.blocks))
            if (away > _THERE_AND_BACK * np.maximum(_steps(following, self._last), one.usual)).any():
                self._returned.append(True)
                return _JUMPS
        self._returned.append(False)
        self._before.append(one.step)
        self._last, self._number, self._tracked = one.blocks, one.number, one.tracked
        return USABLE

    def _lines(self, view: Array) -> Array:
        """(rows,) means of the rows that are read of a view (H, W)."""
        means: Array = view[self._rows[0] // 2 :: self._rows[0], self._columns[0] // 2 :: self._columns[0]].mean(1)
        return means

    def _blocks(self, view: Array) -> Array:
        """(rows, columns) float32, means of blocks of a view (H, W)."""
        (down, rows), (along, columns) = self._rows, self._columns
        sampled = view[down // 2 :: down, along // 2 :: along].astype(np.float32)
        means: Array = rows @ sampled @ columns.T
        return means


def _means(side: int, most: int) -> tuple[int, Array]:
    """Every which pixel is read along a side, and the weights (blocks, pixels read) that give the blocks' means."""
    every = max(1, side // most)
    read = len(range(every // 2, side, every))
    count = min(max(1, side // _BLOCK_PX), _BLOCKS, read)
    weights = np.zeros((count, read), np.float32)
    for place in range(count):
        first, end = place * read // count, -(-(place + 1) * read // count)
        weights[place, first:end] = 1 / (end - first)
    return every, weights


class _Doubtful(NamedTuple):
    """A frame of which the next one says whether it counts, its step a frame, and what is usual."""

    number: int
    blocks: dict[str, Array]
    tracked: int
    step: float
    usual: float


def _steps(blocks: Mapping[str, Array], before: Mapping[str, Array]) -> Array:
    """How far each row of blocks, of all views, is from that before, over the light of its frame, whatever the lamp
    does.
    """
    tiny = np.finfo(np.float32).tiny
    rows = []
    for name, one in blocks.items():
        now, then = one / max(float(one.mean()), tiny), before[name] / max(float(before[name].mean()), tiny)
        rows.append(np.abs(now - then).mean(1))
    return np.concatenate(rows)


def _change_of_light(blocks: Array, before: Array) -> float:
    """By how much nine tenths of the blocks at least have become lighter, or darker: logarithm of the quotient."""
    if blocks.size < _FEWEST_BLOCKS:
        return 0.0
    change = np.log(np.maximum(blocks, 1) / np.maximum(before, 1))
    low, high = np.quantile(change, (0.1, 0.9))
    return float(max(low, -high, 0.0))
