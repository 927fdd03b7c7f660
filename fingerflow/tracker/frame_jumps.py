"""Detection of frames in which the image jumps and then returns; the same rule serves recordings and live streams."""

from itertools import pairwise
from typing import Any

import numpy as np
import numpy.ma  # which the first call of `quantile` would load, while a frame waits
from numpy.typing import NDArray

from fingerflow.tracker.frame_distances import LONGEST

# Limits on squared distances. The least relative excess of a jump: noise alone gives at most 0.16, a jump of 0.3 px
# gives 0.25 (`tests.silent.frames`). Where light flickers or a finger vibrates, a distance must be four times the usual
# one, its square 16 times.
_LEAST_EXCESS, _FAR = 0.25, 16.0
NEARBY = 8  # number of steps before and after a frame from which ordinary distances are estimated
# Added to the limit of the excess for moving skin, which may jerk: a step may then be 1.8 times an ordinary one.
_JERK = 2.0
_USUAL = 0.9  # quantile of the excesses that counts as usual
_SLOW = 0.1  # quantile of the steps that counts as noise
_ALIKE = 0.2  # least ratio of the ways there and back: skin that lands rushes, and then swings back by a little
_BACK = 0.6  # the image returns if both ends differ by less than this share of the longer way, there or back
# Least limit of the excess in the first and last frames, where no frames beyond tell whether the image returns.
_LEAST_AT_END = 1.25
_MOST = 0.1  # largest share of frames with a jump: with more, the finger vibrates or the lamp flickers
SquaredDistances = NDArray[Any]


# Ordinary values (rows,) in a recording or stream so far, for each row of squared image distances: the noise in a
# distance, that of frames without motion or of the slowest; and the relative excess over usual distances above which a
# frame jumps where frames are at rest.
Ordinary = tuple[SquaredDistances, SquaredDistances]


def ordinary_values(steps: SquaredDistances, excesses: SquaredDistances) -> Ordinary:
    """Estimate noise and excess limit of ordinary frames from the squared distances `steps` (n, rows) between
    consecutive frames, and from their relative excesses (m, rows) over usual distances (`excess`).
    """
    usual = np.quantile(excesses, _USUAL, axis=0) if len(excesses) else np.zeros(steps.shape[1])
    limit = np.fmax(_FAR * usual - 1, _LEAST_EXCESS)
    return np.quantile(steps, _SLOW, axis=0).astype(np.float32), limit.astype(np.float32)


def is_jump(
    into: SquaredDistances, out_of: SquaredDistances, between: SquaredDistances, within: SquaredDistances,
    usual: SquaredDistances, ordinary: Ordinary,
) -> bool:  # fmt: skip
    """Return True if the image jumps away in some frames and returns behind them, in any row (a band of lines, the
    whole view or the brightness) of squared image distances (..., rows).

    - The ways into the frames and out of them are longer than ordinary steps: by more where the skin moves, as it may
      jerk, than at rest, where noise alone makes distances. Steps between them are as ordinary, as those of a finger
      that taps are not; or both ways are four times as long as those nearby.
    - The image returns: the way between the frames around them is shorter than the longer way, there or back, and the
      shorter way is no small part of it. What moves on, however unevenly, gets further from where it was.

    Args:
        into: of the first of these frames from the frame before them.
        out_of: of the frame behind them from the last of them.
        between: of the frame behind them from the one before them.
        within: longest step between consecutive ones of them; 0 for one frame.
        usual: of consecutive frames nearby; it holds the noise that is part of every distance.
        ordinary: what is ordinary in the whole recording.
    """
    usual = np.fmax(usual, 1)
    longer, shorter = np.maximum(into, out_of) - usual, np.minimum(into, out_of) - usual
    most = np.maximum(usual, within)
    far = excess(into, out_of, most) > _excess_limit(most, ordinary)
    very_far = shorter > usual * np.maximum(ordinary[1], _FAR - 1)
    return bool(((far | very_far) & (between - usual < _BACK * longer) & (shorter > _ALIKE * longer)).any())


def is_far(step: SquaredDistances, gap: int, usual: SquaredDistances, ordinary: Ordinary | None = None) -> bool:
    """Return True if a frame differs much more from the usable one `gap` frames before than neighbouring frames usually
    do, so that the image may have jumped, in any of the compared parts: bands of image lines, the whole view, or the
    brightness.

    `step` and `usual` are squared distances (parts,); the steps of frames between that are not usable add up. The limit
    follows from `ordinary`, the excesses of other frames; without these it is the smallest limit.
    """
    usual = np.fmax(usual * min(gap, LONGEST + 1) ** 2, 1)
    limit = _LEAST_EXCESS if ordinary is None else _excess_limit(usual, ordinary)
    return bool(np.logical_or.reduce(excess(step, step, usual) > limit))


def _excess_limit(usual: SquaredDistances, ordinary: Ordinary) -> SquaredDistances:
    """Return the limits (..., rows) above which the relative `excess` of a squared distance over the `usual` ones
    counts as a jump: higher for moving skin, whose usual distances exceed the noise, as it may jerk.
    """
    noise, limit = ordinary
    moving = 1 - np.clip(noise, 1, usual) / usual
    return (limit + _JERK * moving).astype(np.float32)


def excess(into: SquaredDistances, out_of: SquaredDistances, usual: SquaredDistances) -> SquaredDistances:
    """Return the relative excess (..., rows) of the smaller of two squared distances, those into and out of some
    frames, over the usual one between consecutive frames: 0 for a usual distance, 1 for twice as much.
    """
    return np.minimum(into, out_of) / np.fmax(usual, 1) - 1


def ordinary_limit(steps: SquaredDistances, axis: int) -> SquaredDistances:
    """Return the upper limit of ordinary squared distances between consecutive frames, estimated from `NEARBY` of them
    along an axis of `steps`.

    It is the third largest of them, two of which may be those of a bad frame, times its quotient to their median: one
    for smooth motion, more the more it jerks.
    """
    ordered = steps.copy()
    ordered.sort(axis=axis)
    most, middle = np.fmax(ordered.take(-3, axis=axis), 1), np.fmax(ordered.take(NEARBY // 2, axis=axis), 1)
    return most * (most / middle)


def jumps_and_returns(distances: SquaredDistances, usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask (F,) of frames with a jump: far from the frames before and after, which are close to each other.

    Real changes persist: skin moves on, a lamp or a knocked camera stays changed. A frame from another moment, torn,
    shifted or of another brightness, is far from both neighbours, while these are as close to the frames beyond them as
    ever, and closer to each other (`is_jump`). Up to `LONGEST` such frames in a row are found. As many at the beginning
    and at the end are marked where they are further from all others than they may be: no frames tell whether the image
    returns.

    At 300 frames/s a vibration of 40 to 150 Hz returns as fast. A lasting one raises what is usual, or is found in more
    than a tenth of the frames.

    Args:
        distances: (F, LONGEST + 1, rows) of `squared_distances_before`.
        usable: (F,) False for frames already known to be invalid, with which none is compared.

    Returns:
        (F,) bool; all False if more than a tenth would be marked, and more than `LONGEST`, as this is the motion of the
        skin or the light.
    """
    frames = len(distances)
    jumps = np.zeros(frames, dtype=bool)
    if frames < 2:
        return jumps
    before, after, around = _steps(distances)
    ordinary = ordinary_values(distances[1:, 0], excess(distances[1:-1, 0], distances[2:, 0], around))
    # Whether frames from the second on may begin a jump, by their distance from the frame right before them.
    likely = np.any(excess(distances[1:, 0], distances[1:, 0], before[:-1]) > _LEAST_EXCESS, axis=1)
    good = iter(usable.nonzero()[0].tolist())
    last = next(good, frames)
    for frame in good:
        if frame <= last:
            continue
        length = 0
        if likely[frame - 1] or last != frame - 1:
            length = _length_of_jump(distances, before[last], after, last, frame, usable, ordinary)
        jumps[frame : frame + length] = True
        last = frame + length
    jumps &= usable
    # Next to an end, the image may have returned: only what is left is judged without frames beyond.
    jumps |= _far_at_end(distances, usable & ~jumps, before, ordinary)
    jumps |= _far_at_end(_reversed(distances), (usable & ~jumps)[::-1], after[::-1], ordinary)[::-1]
    return jumps if jumps.sum() <= max(_MOST * frames, LONGEST) else np.zeros_like(jumps)


def _length_of_jump(
    distances: SquaredDistances, before: SquaredDistances, after: SquaredDistances, last: int, frame: int,
    usable: NDArray[np.bool_], ordinary: Ordinary,
) -> int:  # fmt: skip
    """Return for how many frames the image jumps away, from `frame` on, until the image of `last`, the usable frame
    before, is back; 0 if there is no such jump.

    `before` (rows,) are the usual steps before `last`, `after` (F, rows) those after each frame.
    """
    latest, within = frame, np.zeros_like(before)  # last frame of the jump; longest step between its frames
    for length in range(1, LONGEST + 1):
        back = frame + length
        if back >= len(distances) or back - last > LONGEST + 1:
            break
        if not usable[back]:
            continue
        into, out_of = distances[frame, frame - last - 1], distances[back, back - latest - 1]
        usual = np.maximum(before, after[back])
        if is_jump(into, out_of, distances[back, back - last - 1], within, usual, ordinary):
            return length
        latest, within = back, np.fmax(within, out_of)
    return 0


def _steps(distances: SquaredDistances) -> tuple[SquaredDistances, SquaredDistances, SquaredDistances]:
    """Return the usual squared distances between consecutive frames near each of F frames, from the distances (F, gaps,
    rows) of each frame from those that precede it: among the frames before it (F, rows), among those after it (F,
    rows), and the longer of the steps nearest to the frames before and behind it (F - 2, rows).

    A step is the distance of a frame from the closer of two preceding frames, or of two following ones. What is usual
    is the longer of the nearest step and the `ordinary_limit` of the next eight, or the median over the recording where
    nothing is known. A frame that repeats another has no distance from it.
    """
    median = np.median(distances[1:, 0], axis=0)
    distances = np.where(distances > 0, distances, np.float32(np.nan))
    before = np.fmin(distances[:, 0], distances[:, 1])
    after = np.full_like(before, np.nan)
    after[:-1] = distances[1:, 0]
    after[:-2] = np.fmin(after[:-2], distances[2:, 1])
    before, after = (np.where(np.isnan(steps), median, steps) for steps in (before, after))
    around = np.maximum(before[:-2], after[2:])
    limits = _ordinary_limits(before), _ordinary_limits(after[::-1])[::-1]
    return np.maximum(before, limits[0]), np.maximum(after, limits[1]), around


def _ordinary_limits(steps: SquaredDistances) -> SquaredDistances:
    """Return for each frame (F, rows) the upper limit of ordinary squared distances (`ordinary_limit`), estimated from
    the last `NEARBY` distances between consecutive frames in `steps` (F, rows).

    The first frames, which have fewer steps before them, have the limit of the first `NEARBY` steps.
    """
    if len(steps) < NEARBY:
        return np.zeros_like(steps)
    result = ordinary_limit(np.lib.stride_tricks.sliding_window_view(steps, NEARBY, axis=0), axis=-1)
    return np.concatenate((np.repeat(result[:1], NEARBY - 1, axis=0), result))


def _far_at_end(
    distances: SquaredDistances, usable: NDArray[np.bool_], usual: SquaredDistances, ordinary: Ordinary
) -> NDArray[np.bool_]:
    """Return the mask (F,) of frames at the end of a recording, `LONGEST` at most, from the first on whose squared
    distance from the frame before is far larger than usual.

    Whether such a change stays is not known. `usual` (F, rows) are the steps before each frame.
    """
    result, last = np.zeros(len(distances), dtype=bool), usable.nonzero()[0][-LONGEST - 1 :].tolist()
    # With fewer frames there are too few steps to estimate usual ones.
    if len(distances) > NEARBY and len(last) == LONGEST + 1 and last[-1] - last[0] <= LONGEST + 1:
        steps = np.stack([distances[frame, frame - before - 1] for before, frame in pairwise(last)])
        ordinary = ordinary[0], np.fmax(ordinary[1], _LEAST_AT_END)
        for k, step in enumerate(steps):
            # Longest of the later steps: a finger that has begun to move moves on.
            usual_step = np.maximum(usual[last[k]], steps[k + 1 :].max(0, initial=0))
            if is_far(step, last[k + 1] - last[k], usual_step, ordinary):
                result[last[k + 1] :] = True
                break
    return result & usable


def _reversed(distances: SquaredDistances) -> SquaredDistances:
    """Return the squared distances (F, gaps, rows) of each frame from those that precede it, after the order of the
    frames is reversed.
    """
    frames, gaps, _ = distances.shape
    result = np.full_like(distances, np.nan)
    for gap in range(1, min(gaps, frames - 1) + 1):
        result[gap:, gap - 1] = distances[gap:, gap - 1][::-1]
    return result
