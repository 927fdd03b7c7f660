"""Detection of frames in which the image jumps and returns: one rule for a recording and for a stream."""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from fingerflow.tracker.frame_distances import LONGEST

# Limits of the excess: noise alone gives 0.16 at most, a jump of 0.3 px gives 0.25 (`tests.silent.frames`). A distance
# must be four times what is usual where light flickers or a finger vibrates.
_LEAST_EXCESS, _FAR = 0.25, 16.0
_USUAL = 0.9  # quantile of the excess that is taken as usual
_BACK = 0.6  # share of the longer way, there or back, below which the rest between both ends is a return
_FAR_AT_END = 2.25  # limit for the first and last frame, with neighbours on one side only
_MOST = 0.1  # share of the frames: if more jump, the finger vibrates or the lamp flickers
SquaredDistances = NDArray[np.float32]


def excess(into: SquaredDistances, out_of: SquaredDistances, usual: SquaredDistances) -> SquaredDistances:
    """Return by how much the ways (..., rows) into one to `LONGEST` frames and out of them exceed the steps nearby.

    Args:
        into: squared distance of the first of these frames from the frame before them.
        out_of: squared distance of the frame behind them from the last of them.
        usual: squared distance of consecutive frames nearby; it holds the noise that is part of every distance.
    """
    result: SquaredDistances = np.minimum(into, out_of) / np.fmax(usual, 1) - 1
    return result


def returns(
    into: SquaredDistances, out_of: SquaredDistances, between: SquaredDistances, usual: SquaredDistances
) -> NDArray[np.bool_]:
    """Return whether the image returns (..., rows): `between`, from before these frames to behind them, is shorter.

    It is compared with the longer way, there or back. What moves on, however unevenly, gets further from where it was.
    Other arguments are those of `excess`.
    """
    usual = np.fmax(usual, 1)
    result: NDArray[np.bool_] = between - usual < _BACK * (np.maximum(into, out_of) - usual)
    return result


def limit_of(excesses: SquaredDistances) -> SquaredDistances:
    """Return the limits (rows,) of an excess, from the excesses (n, rows) of single frames so far, or of a recording."""
    if not len(excesses):
        return np.full(excesses.shape[1], _LEAST_EXCESS, np.float32)
    # Without NaN both are the same, but `nanquantile` is slower: it goes column by column.
    quantile = np.nanquantile if np.isnan(excesses).any() else np.quantile
    usual = quantile(excesses, _USUAL, axis=0)
    result: SquaredDistances = np.fmax(_FAR * usual - 1, _LEAST_EXCESS).astype(np.float32)
    return result


def jumps_and_returns(distances: SquaredDistances, usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask (F,) of jumps that return: frames far from both adjacent frames, which are close to each other.

    Real changes persist: skin moves on, a lamp or a knocked camera stays changed. A frame from another moment, torn,
    shifted or of another brightness, is far from both neighbours, while these are as close to the frames beyond them as
    ever, and closer to each other: its `excess` is large and the image `returns`. Up to `LONGEST` such frames in a row
    are found. The first and the last
    frame have neighbours on one side only, and are marked if they are 1.5 times as far from them as these from each other.

    At 300 frames/s a vibration of 40 to 150 Hz returns as fast. A lasting one raises what is usual, or is found in more
    than a tenth of the frames.

    Args:
        distances: (F, LONGEST + 1, rows) of `squared_distances_before`.
        usable: (F,) False for frames already known to be invalid, with which none is compared.

    Returns:
        (F,) bool; all False if more than a tenth would be marked, as this is the motion of the skin or the light.
    """
    frames = len(distances)
    found = np.zeros(frames, dtype=bool)
    steps = _steps(distances)
    excesses = [_excesses(distances, steps, length) for length in range(1, LONGEST + 1)]
    limits = [limit_of(one) for one in excesses]
    # Frames with which a jump may begin, by comparison with the frame right before them.
    likely = np.zeros(frames, dtype=bool)
    for one, limit in zip(excesses, limits, strict=True):
        likely[1 : 1 + len(one)] |= (one > limit).any(1)
    for known, apart in ((usable, distances), (usable[::-1], _reversed(distances))):
        far = _far_at_start(apart, np.flatnonzero(known))
        found |= far if known is usable else far[::-1]
    good = iter(np.flatnonzero(usable & ~found).tolist())
    last = next(good, frames)
    for frame in good:
        if frame <= last:
            continue
        length = 0
        if likely[frame] or last != frame - 1:
            length = _length_of_jump(distances, steps, last, frame, usable, limits)
            found[frame : frame + length] = True
        last = frame + length
    found &= usable
    return found if found.mean() <= _MOST else np.zeros_like(found)


def _length_of_jump(
    distances: SquaredDistances,
    steps: tuple[SquaredDistances, SquaredDistances],
    last: int,
    frame: int,
    usable: NDArray[np.bool_],
    limits: list[SquaredDistances],
) -> int:
    """Return the number of frames of a jump that begins in `frame` and returns to the image of `last`; 0 for no jump.

    A jump ends when the image of frame `last` is back.
    """
    latest = frame  # of the jump
    for length in range(1, LONGEST + 1):
        back = frame + length
        if back >= len(distances) or back - last > LONGEST + 1:
            break
        if not usable[back]:
            continue
        into, out_of = distances[frame, frame - last - 1], distances[back, back - latest - 1]
        usual = np.maximum(steps[0][last], steps[1][back])
        far = excess(into, out_of, usual) > limits[length - 1]
        if (far & returns(into, out_of, distances[back, back - last - 1], usual)).any():
            return length
        latest = back
    return 0


def _steps(distances: SquaredDistances) -> tuple[SquaredDistances, SquaredDistances]:
    """Return the distance (F, rows) of each frame from the closer of two preceding frames, and of two following ones.

    It is the median over the recording where there are none. A frame that repeats another has no distance from it.
    """
    if len(distances) < 2:
        return np.ones_like(distances[:, 0]), np.ones_like(distances[:, 0])
    median = np.median(distances[1:, 0], axis=0)
    distances = np.where(distances > 0, distances, np.float32(np.nan))
    before = np.fmin(distances[:, 0], distances[:, 1])
    after = np.full_like(before, np.nan)
    after[:-1] = distances[1:, 0]
    after[:-2] = np.fmin(after[:-2], distances[2:, 1])
    return np.where(np.isnan(before), median, before), np.where(np.isnan(after), median, after)


def _excesses(
    distances: SquaredDistances, steps: tuple[SquaredDistances, SquaredDistances], length: int
) -> SquaredDistances:
    """Return the `excess` (F - length - 1, rows) of each run of `length` frames."""
    back = np.arange(length + 1, len(distances))
    last = back - length - 1
    usual = np.maximum(steps[0][last], steps[1][back])
    return excess(distances[last + 1, 0], distances[back, 0], usual)


def _far_at_start(distances: SquaredDistances, known: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Mark the first usable frame in a mask (F,) if it is far from the next three frames, which are close together."""
    result = np.zeros(len(distances), dtype=bool)
    first, *after = known[:4].tolist() or [0]
    if len(after) == 3 and after[-1] - first <= LONGEST + 1:
        away = np.min([distances[k, k - first - 1] for k in after], axis=0)
        among = np.max([distances[k, k - j - 1] for j, k in combinations(after, 2)], axis=0)
        result[first] = (away > _FAR_AT_END * np.maximum(among, 1)).any()
    return result


def _reversed(distances: SquaredDistances) -> SquaredDistances:
    """Reorder squared distances as if the frames came in reversed order."""
    frames, gaps, _ = distances.shape
    result = np.full_like(distances, np.nan)
    for gap in range(1, min(gaps, frames - 1) + 1):
        result[gap:, gap - 1] = distances[gap:, gap - 1][::-1]
    return result
