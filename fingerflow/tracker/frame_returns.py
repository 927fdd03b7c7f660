"""Detection of invalid frames of a recording: frames in which the image jumps and returns, or is repeated."""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from fingerflow.tracker.frame_distances import LONGEST

# Limit of the distance to both neighbours over that between them. A shift by 5 px gives 5 to 30, noise 2.
FAR = 4.0
_USUAL = 0.9  # quantile of that quotient over the recording that is taken as usual: lamps flicker, fingers vibrate
_FAR_AT_END = 5.0  # limit for the first and last frame, with neighbours on one side only
_MOST = 0.1  # share of the frames: if more jump, the finger vibrates or the lamp flickers
REPEATED_SHARE = 0.2  # of the frames, beyond which repetitions are normal for the camera and no fault
Distances = NDArray[np.float32]


def jumps_and_returns(distances: Distances, usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask (F,) of frames whose image differs from both adjacent frames, which resemble each other.

    Real changes persist: skin moves on, a lamp or a knocked camera stays changed. A frame from another moment, torn,
    shifted or of another brightness, is far from both neighbours, while these are as close to each other and to the
    frames beyond them as ever. A frame is marked if, in some row of blocks or in its light, it is four times as far,
    four times as far as consecutive frames mostly are, and four times what is usual where light flickers or a finger
    vibrates. Up to `LONGEST` such frames in a row are found. The first and the last frame have neighbours on one side
    only, and are marked if they are five times as far from them as these from each other.

    At 300 frames/s a vibration of 40 to 150 Hz returns as fast. A lasting one raises what is usual, or is found in more
    than a tenth of the frames.

    Args:
        distances: (F, LONGEST + 1, rows) of `block_distances`.
        usable: (F,) False for frames already known to be invalid, with which none is compared.

    Returns:
        (F,) bool; all False if more than a tenth would be marked, as this is the motion of the skin or the light.
    """
    frames = len(distances)
    found = np.zeros(frames, dtype=bool)
    # Distances that are due to noise vary by as much as their own size.
    if frames > 1:
        distances = (distances / np.fmax(np.nanmedian(distances[1:, 0], axis=0), 1)).astype(np.float32)
    steps = _neighbour_distances(distances)
    quotients = [_jump_measure(distances, steps, length) for length in range(1, LONGEST + 1)]
    limits = [FAR * _usual_level(one) for one in quotients]
    # Frames with which a jump may begin, by comparison with the frame right before them.
    likely = np.zeros(frames, dtype=bool)
    for quotient, limit in zip(quotients, limits, strict=True):
        likely[1 : 1 + len(quotient)] |= (quotient > limit).any(1)
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
    distances: Distances,
    steps: tuple[Distances, Distances],
    last: int,
    frame: int,
    usable: NDArray[np.bool_],
    limits: list[NDArray[np.float32]],
) -> int:
    """Return how many frames, from `frame` on, differ from the image of `last` before that image returns; 0 if none.

    A jump ends when the image of frame `last` is back.
    """
    for length in range(1, LONGEST + 1):
        back = frame + length
        if back >= len(distances) or back - last > LONGEST + 1:
            break
        if not usable[back]:
            continue
        out = [np.minimum(distances[k, k - last - 1], distances[back, back - k - 1]) for k in range(frame, back)]
        quotient = np.min(out, axis=0) / _denominator(distances[back, back - last - 1], steps[0][last], steps[1][back])
        if (quotient > limits[length - 1]).any():
            return length
    return 0


def _neighbour_distances(distances: Distances) -> tuple[Distances, Distances]:
    """Return distances (F, rows) of each frame from the nearer of the two frames before, and of the two frames after.

    They are 0 where there are none.
    """
    before = np.fmin(distances[:, 0], distances[:, 1])
    after = np.zeros_like(before)
    after[:-1] = distances[1:, 0]
    after[:-2] = np.fmin(after[:-2], distances[2:, 1])
    return np.nan_to_num(before), after


def _denominator(pair: Distances, before: Distances, after: Distances) -> Distances:
    """Return the denominator of the jump measure: the largest of the given distances and 1."""
    result: Distances = np.maximum(np.maximum(pair, 1), np.maximum(before, after))
    return result


def _jump_measure(distances: Distances, steps: tuple[Distances, Distances], length: int) -> Distances:
    """Return a jump measure (F - length - 1, rows) of each run of `length` frames: large for a jump that returns.

    It is the distance of the run from the two frames around it, over the distance between these two.
    """
    back = np.arange(length + 1, len(distances))
    last = back - length - 1
    out = [np.minimum(distances[last + j, j - 1], distances[back, length - j]) for j in range(1, length + 1)]
    result: Distances = np.min(out, axis=0) / _denominator(distances[back, length], steps[0][last], steps[1][back])
    return result


def _usual_level(quotients: Distances) -> Distances:
    """Return the level (rows,) that jump measures usually stay below: the 0.9 quantile over a recording, at least 1."""
    if not len(quotients):
        return np.ones(quotients.shape[1], np.float32)
    # Without NaN both are the same, but `nanquantile` is slower: it goes column by column.
    quantile = np.nanquantile if np.isnan(quotients).any() else np.quantile
    result: Distances = np.maximum(quantile(quotients, _USUAL, axis=0), 1).astype(np.float32)
    return result


def _far_at_start(distances: Distances, known: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return a mask (F,) that marks the first usable frame if far from the next three, which are close together."""
    result = np.zeros(len(distances), dtype=bool)
    first, *after = known[:4].tolist() or [0]
    if len(after) == 3 and after[-1] - first <= LONGEST + 1:
        away = np.min([distances[k, k - first - 1] for k in after], axis=0)
        among = np.max([distances[k, k - j - 1] for j, k in combinations(after, 2)], axis=0)
        result[first] = (away > _FAR_AT_END * np.maximum(among, 1)).any()
    return result


def _reversed(distances: Distances) -> Distances:
    """Convert the distances of `block_distances` to those of the frames in reversed order."""
    frames, gaps, _ = distances.shape
    result = np.full_like(distances, np.nan)
    for gap in range(1, min(gaps, frames - 1) + 1):
        result[gap:, gap - 1] = distances[gap:, gap - 1][::-1]
    return result


def repeats(distances: Distances) -> NDArray[np.bool_]:
    """Return a mask (F,) of the frames that repeat the preceding frame: all block means are equal.

    Frames next to another such frame are left out.
    """
    same: NDArray[np.bool_] = (distances[:, 0] == 0).all(1)
    result = same.copy()
    result[1:-1] &= ~same[:-2] & ~same[2:]
    if len(result) > 1:
        result[-1] &= not same[-2]
    return result
