"""Frames that cannot be: the picture jumps and comes back, or comes twice."""

from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

#: Frames in a row, at most, after which a picture that comes back counts as the one before.
LONGEST = 3
_BANDS = 16  # a tear, or lines that were lost, lie in a few rows
_LEVEL = 1e-3  # least distance, of the mean of the picture: below it lies rounding
_FAR = 2.0  # times as far from both neighbours as these are from each other
_USUAL = 0.75  # quantile of that quotient over the recording: lamps flicker, fingers vibrate
_FAR_AT_END = 4.0  # where there is one neighbour
Distances = NDArray[np.float32]


def band_distances(frames: Tensor, before: Tensor) -> Tensor:
    """Mean absolute difference of each frame to the `LONGEST` + 1 before it, in bands of rows.

    Args:
        frames: (n, 1, H, W) floating.
        before: (m, 1, H, W) the frames before them, as far as there are any.

    Returns:
        (n, LONGEST + 1, bands), of its type; NaN where there is no such frame.
    """
    every = torch.cat([before, frames])
    height = every.shape[2]
    bands = max(1, min(_BANDS, height // 2))
    cut = every[:, 0, : height // bands * bands]
    result = cut.new_full((len(frames), LONGEST + 1, bands), torch.nan)
    for gap in range(1, LONGEST + 2):
        first = max(gap - len(before), 0)  # of `frames`
        start = len(before) + first
        apart = (cut[start:] - cut[start - gap : len(every) - gap]).abs()
        result[first:, gap - 1] = apart.unflatten(1, (bands, -1)).mean((2, 3))
    return result


def jumps_and_returns(distances: Distances, mean: float, usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Frames that are further from those before and after them than these are from each other.

    What moves, moves on: skin, a lamp, a camera that is knocked. A frame of another moment, torn, shifted or of another
    brightness, is far from both of its neighbours, and these are as near as ever: in some band of rows, at least twice
    as far, and twice what is usual in this recording where light flickers. Up to `LONGEST` such frames in a row are
    found. The first and the last frame have one neighbour, and count where they are four times as far from it as the
    next ones from each other.

    Args:
        distances: (F, LONGEST + 1, bands) of `band_distances`.
        mean: of the pictures.
        usable: (F,) False for frames that are known to be no pictures: none is measured by them.

    Returns:
        (F,) bool.
    """
    frames = len(distances)
    found = np.zeros(frames, dtype=bool)
    floor = np.float32(_LEVEL * mean)
    quotients = [_quotients(distances, length, floor) for length in range(1, LONGEST + 1)]
    limits = [_FAR * _usual(one) for one in quotients]
    # Frames with which a jump may begin, by what lies right before them.
    likely = np.zeros(frames, dtype=bool)
    for quotient, limit in zip(quotients, limits, strict=True):
        likely[1 : 1 + len(quotient)] |= (quotient > limit).any(1)
    good = iter(np.flatnonzero(usable).tolist())
    last = next(good, None)
    if last is None:
        return found
    if _first_is_far(distances, np.flatnonzero(usable), floor):
        found[last] = True
        last = next(good)
    for frame in good:
        if frame <= last:
            continue
        length = 0
        if likely[frame] or last != frame - 1:
            length = _length_of_jump(distances, last, frame, usable, limits, floor)
            found[frame : frame + length] = True
        last = frame + length
    if usable[-1] and not found[-1]:
        backwards = _reversed(distances)
        found[-1] = _first_is_far(backwards, np.flatnonzero((usable & ~found)[::-1]), floor)
    return found & usable


def _length_of_jump(
    distances: Distances,
    last: int,
    frame: int,
    usable: NDArray[np.bool_],
    limits: list[NDArray[np.float32]],
    floor: np.float32,
) -> int:
    """Frames from `frame` on after which the picture of the frame `last` is back; 0 where it never left."""
    for length in range(1, LONGEST + 1):
        back = frame + length
        if back >= len(distances) or back - last > LONGEST + 1:
            break
        if not usable[back]:
            continue
        out = [np.minimum(distances[k, k - last - 1], distances[back, back - k - 1]) for k in range(frame, back)]
        ratio = np.min(out, axis=0) / np.maximum(distances[back, back - last - 1], floor)
        if (ratio > limits[length - 1]).any():
            return length
    return 0


def _quotients(distances: Distances, length: int, floor: np.float32) -> Distances:
    """(F - length - 1, bands) how much further the frames between two are from both than these from each other."""
    back = np.arange(length + 1, len(distances))
    last = back - length - 1
    out = [np.minimum(distances[last + j, j - 1], distances[back, length - j]) for j in range(1, length + 1)]
    result: Distances = np.min(out, axis=0) / np.maximum(distances[back, length], floor)
    return result


def _usual(quotients: Distances) -> Distances:
    """(bands,) what they mostly are in the recording, at least 1."""
    if not len(quotients):
        return np.ones(quotients.shape[1], np.float32)
    result: Distances = np.maximum(np.nanquantile(quotients, _USUAL, axis=0), 1).astype(np.float32)
    return result


def _first_is_far(distances: Distances, known: NDArray[np.intp], floor: np.float32) -> bool:
    """Whether the first of the frames `known` is far from the next ones, which are near each other."""
    if len(known) < 4 or known[3] - known[0] > LONGEST + 1:
        return False
    first, *after = known[:4].tolist()
    away = np.min([distances[k, k - first - 1] for k in after], axis=0)
    among = np.max([distances[k, k - j - 1] for j, k in _pairs(after)], axis=0)
    return bool((away > _FAR_AT_END * np.maximum(among, floor)).any())


def _pairs(numbers: list[int]) -> Iterator[tuple[int, int]]:
    return ((one, other) for i, one in enumerate(numbers) for other in numbers[i + 1 :])


def _reversed(distances: Distances) -> Distances:
    """The same of the frames in reversed order."""
    frames, gaps, _ = distances.shape
    result = np.full_like(distances, np.nan)
    for gap in range(1, min(gaps, frames - 1) + 1):
        result[gap:, gap - 1] = distances[gap:, gap - 1][::-1]
    return result


def repeats(distances: Distances) -> NDArray[np.bool_]:
    """(F,) frames that are the one before, pixel by pixel, where those before and after are not."""
    same = (distances[:, 0] == 0).all(1)
    result = same.copy()
    result[1:-1] &= ~same[:-2] & ~same[2:]
    if len(result) > 1:
        result[-1] &= not same[-2]
    return result
