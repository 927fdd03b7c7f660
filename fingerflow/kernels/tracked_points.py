"""Kernels of tracked points, on NumPy arrays: seeding, forward and backward search, outlier detection.

Arrays are checked, and copied only if they are not contiguous.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fingerflow.kernels import outlier_limits
from fingerflow.kernels.arrays import kind, rows_in_one_piece, strides_of_rows
from fingerflow.kernels.checks import FRAME_KINDS, check_frames, check_indices, checked, described, mask_of
from fingerflow.kernels.detection_limits import LEAST_SIDE, NOISE, QUALITY
from fingerflow.kernels.library import entry, threads
from fingerflow.kernels.search_sizes import SEARCHED, sizes_of
from fingerflow.kernels.tracking import WIDEST_SEARCH

Array = NDArray[Any]

_LANES = 16  # points in the SIMD lanes of the compiled kernel
_ROWS = 32  # points whose distances to all others are held in memory at a time


class NeighbourLists(NamedTuple):
    """The k nearest neighbours of N points, nearest first, as arrays (k, P) padded to P points.

    P is the smallest multiple of 16 that is not below N.

    Attributes:
        number: int32.
        x, y: offset from the point, float32; 0 where the neighbour does not count.
        within: float32, 1 where it is known and lies no farther away than half the gauge length, else 0.
    """

    number: Array
    x: Array
    y: Array
    within: Array


class OutlierFlags(NamedTuple):
    """Masks (K, N) of outliers among N points in K frames: those that deviate from their neighbours in displacement,
    and those far more uncertain than their neighbours.
    """

    off_neighbours: Array
    uncertain: Array


def find_neighbours(positions: Array, gauge_length: float) -> NeighbourLists:
    """Find the nearest neighbours of each point for the outlier detection, once for all frames of the points.

    Args:
        positions: (N, 2) reference positions, float32, NaN where there is none. N is 2 or more.
        gauge_length: diameter around a point in which neighbours count, in the unit of the positions.

    Raises:
        ValueError: fewer than 2 points, wrong dtype or shape.
    """
    count = len(positions)
    if count < 2:
        raise ValueError(f"{count} points have no neighbours: give 2 or more")
    positions = checked("positions", positions, "float32", (count, 2))
    most = min(outlier_limits.NEIGHBOURS, count - 1)
    number = np.zeros((most, -(-count // _LANES) * _LANES), np.int32)
    x, y, within = (np.zeros(number.shape, np.float32) for _ in range(3))
    for first in range(0, count, _ROWS):
        own = np.arange(first, min(first + _ROWS, count))
        away_x, away_y = (positions[:, k] - positions[own, k, None] for k in range(2))
        distance = away_x * away_x + away_y * away_y
        near = distance <= np.float32((gauge_length / 2) ** 2)  # False for NaN
        near[own - first, own] = False
        distance[~near] = np.inf
        # Sort by distance, then by index: bit patterns of non-negative floats have the order of the floats.
        order = (distance.view(np.int32).astype(np.int64) << 32) + np.arange(count)
        nearest = np.sort(np.partition(order, most - 1, axis=1)[:, :most], axis=1) & 0xFFFFFFFF
        counts = np.take_along_axis(near, nearest, 1)
        number[:, own], within[:, own] = nearest.T, counts.T
        for to, away in ((x, away_x), (y, away_y)):
            to[:, own] = np.where(counts, np.take_along_axis(away, nearest, 1), np.float32(0)).T
    return NeighbourLists(number, x, y, within)


def find_outliers(neighbours: NeighbourLists, displacement: Array, position_std: Array) -> OutlierFlags:
    """Find, in K frames, the points that deviate from their neighbours in displacement and those that are far more
    uncertain than their neighbours, as `ops.find_outliers`.

    A point at a limit, to the rounding of float32, may have another result than there.

    Args:
        neighbours: from :func:`find_neighbours`, for all frames.
        displacement: (K, N, 2) float32 in the unit of the positions; NaN where it is unknown.
        position_std: (K, N) float32, standard deviation of a component.

    Raises:
        ValueError: wrong dtype or shape.
    """
    frames, count = displacement.shape[:2]
    most, stride = neighbours.number.shape
    displacement = checked("displacement", displacement, "float32", (frames, count, 2))
    position_std = checked("position_std", position_std, "float32", (frames, count))
    if stride != -(-count // _LANES) * _LANES:
        raise ValueError(f"{count} points, and neighbours of {stride - _LANES + 1} to {stride}")
    number = checked("number", neighbours.number, "int32", (most, stride))
    x, y, within = (checked("neighbours", one, "float32", (most, stride)) for one in neighbours[1:])
    if number.size and not 0 <= number.min() <= number.max() < count:
        raise ValueError(f"neighbours go from {number.min()} to {number.max()}: there are {count} points")
    result = OutlierFlags(*(np.empty((frames, count), np.bool_) for _ in range(2)))
    entry("find_outliers")(
        number=number,
        x=x,
        y=y,
        within=within,
        displacement=displacement,
        deviation=position_std,
        off_neighbours=result.off_neighbours,
        uncertain=result.uncertain,
        frames=frames,
        points=count,
        stride=stride,
        neighbours=most,
        spread=outlier_limits.SPREAD,
        ridge=outlier_limits.RIDGE,
        least_deviation=outlier_limits.LEAST_DEVIATION,
        most_disagreement=outlier_limits.MOST_DISAGREEMENT,
        most_uncertainty=outlier_limits.MOST_UNCERTAINTY,
        least_neighbours=outlier_limits.LEAST_NEIGHBOURS,
        threads=threads(),
    )
    return result


def search_and_return(
    key: Array,
    current: Array,
    start: Array,
    guess: Array,
    *,
    window: int,
    radius: int,
    forward_backward_limit: float,
    image_index: Array | None = None,
) -> tuple[Array, Array]:
    """Search an image for the windows around points of another image, near guessed positions, and verify each match by
    a search back from there.

    The method is that of `ops.tracking.search.search_and_return`.

    Args:
        key, current: (B, 1, H, W) of FRAME_KINDS, at least 3 x 3 px.
        start: (n, 2) px in `key`, float32.
        guess: (n, 2) px in `current`, float32.
        window: px, side of the tracking window.
        radius: px, around the guess in x and y.
        forward_backward_limit: px.
        image_index: (n,) int64, the image of each point; the first one by default.

    Returns:
        Positions (n, 2), `guess` where it is not finite or nothing correlates; and whether (n,) the backward search
        returns to `start`.

    Raises:
        TypeError, ValueError: wrong dtype, inconsistent shapes, a search wider than WIDEST_SEARCH.
    """
    check_frames(key)
    check_frames(current)
    count, (batch, _, height, width) = len(start), key.shape
    if key.shape != current.shape or min(height, width) < 3:
        raise ValueError(f"images of {key.shape} and {current.shape}: give two of one shape, at least 3 x 3 px")
    start = checked("start", start, "float32", (count, 2))
    guess = checked("guess", guess, "float32", (count, 2))
    index = np.zeros(count, np.int64) if image_index is None else image_index
    index = checked("image_index", index, "int64", (count,))
    check_indices("image_index", index, batch, "images")
    key, current = rows_in_one_piece(key), rows_in_one_piece(current)
    (key_stride, key_row_stride), (current_stride, current_row_stride) = strides_of_rows(key), strides_of_rows(current)
    size, reach = sizes_of(window, radius)
    if window < 1 or radius < 0 or size + 2 * reach > WIDEST_SEARCH:
        raise ValueError(f"a search of {window} px windows within {radius} px: 1 px or more, {WIDEST_SEARCH} px in all")
    found, returns = np.empty((count, 2), np.float32), np.empty(count, np.bool_)
    entry("search_and_return")(
        key=key,
        key_stride=key_stride,
        key_row_stride=key_row_stride,
        key_kind=FRAME_KINDS[kind(key)],
        current=current,
        current_stride=current_stride,
        current_row_stride=current_row_stride,
        current_kind=FRAME_KINDS[kind(current)],
        image_index=index,
        start=start,
        guess=guess,
        found=found,
        returns=returns,
        batch=batch,
        height=height,
        width=width,
        count=count,
        size=size,
        reach=reach,
        limit=forward_backward_limit + SEARCHED,
        threads=threads(),
    )
    return found, returns


class DetectedPoints(NamedTuple):
    """Positions (n, 2) px and responses (n,) of detected corners, float32, strongest first, padded with NaN."""

    points: Array
    response: Array


def detect_points(frame: Array, mask: Array, count: int, *, min_distance_px: float, window: int) -> DetectedPoints:
    """Detect corners to track, as `graphs.DetectGraph`, except for the choice among equal corner responses.

    Args:
        frame: (1, 1, H, W) of FRAME_KINDS, at least 7 x 7 px.
        mask: (H, W) bool, where points may lie.
        count: largest number of points; n is `count`, or the number of pixels if this is smaller.
        min_distance_px: side of the smallest square in which a point must be the strongest.
        window: px, side of the tracking window, which stays inside the frame.

    Raises:
        TypeError, ValueError: wrong dtype or shape, fewer than 1 point.
    """
    check_frames(frame)
    (images, _, height, width) = frame.shape
    if images != 1 or min(height, width) < LEAST_SIDE or height * width >= 1 << 31:
        raise ValueError(f"a frame of {frame.shape}: give one of {LEAST_SIDE} x {LEAST_SIDE} px to 2^31 pixels")
    if count < 1 or window < 1:
        raise ValueError(f"{count} points with windows of {window} px: give 1 or more of each")
    if not math.isfinite(min_distance_px):
        raise ValueError(f"points {min_distance_px} px apart: give a finite distance")
    frame, mask = rows_in_one_piece(frame), mask_of(frame, mask[None, None])
    count = min(count, height * width)
    beside = max(1, round(min_distance_px / 2))
    points, response = np.empty((count, 2), np.float32), np.empty(count, np.float32)
    entry("detect_points")(
        **described(frame),
        mask=mask,
        points=points,
        responses=response,
        mask_row_stride=strides_of_rows(mask)[1],
        border=min(window // 2 + 3, (min(height, width) - 1) // 2),
        beside=beside,
        farthest=max(beside + 1, math.isqrt(height * width // count)),
        count=count,
        quality=QUALITY,
        noise=NOISE,
        threads=threads(),
    )
    return DetectedPoints(points, response)
