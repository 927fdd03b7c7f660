"""Kernels of tracked points: templates, registration, correction, search, outliers, spline, noise.

Frames (B, 1, H, W) are of `declarations.FRAME_KINDS`, all else is float32 unless another dtype is named. What does not
fit the declaration of a kernel raises TypeError (wrong dtype) or ValueError.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fingerflow.kernels import outlier_limits
from fingerflow.kernels.arrays import Array
from fingerflow.kernels.field_limits import MINIMUM_POINTS, MINIMUM_SPREAD
from fingerflow.kernels.library import compiled
from fingerflow.kernels.result_records import CorrectedPoints

_WIDEST_SEARCH = 1 << 15  # px, widest search: positions in it must be countable with 32 bits
_LANES = 16  # points in the SIMD lanes of the compiled kernel
_ROWS = 32  # points whose distances to all others are held in memory at a time
# Side of the template of a wide search in tracking windows. Ridges repeat every 15 px: a window of 21 px holds little
# more than one of them and matches the neighbouring ridge almost as well; 63 px hold the bends and endings by which
# ridges differ. A search within a few px needs no larger template, as there is no neighbouring ridge.
_WIDENING = 3
SEARCHED = 1.0  # accuracy of a search, px of the full image


def find_templates(
    templates: Sequence[Array],
    frames: Array,
    place: Array,
    speed: Array | None,
    variance: Array | None,
    rounds: int,
    rounding: float,
    forward_backward_limit: float,
    mismatch_limit: float,
) -> tuple[Array, Array, Array, Array, Array, Array, Array]:
    """Track the templates of B x N points through K frames each, in one call; return the fields of
    `TrackedPoints` (K, B, N, ...), and positions and speeds (B, N, 2) after the last frame.

    Frames are (K B, 1, H, W), frame k of batch b at k B + b. The prediction for the first frame is `place` + `speed`,
    both (B, N, 2), px and px a frame. `variance` is (K B,).
    """
    start, samples, numbers = templates
    recordings, total = max(place.shape[0], 1), frames.shape[0]
    if total % recordings:
        raise ValueError(f"{total} frames cannot be those of {recordings} recordings")
    place, speed, points, error, covariance, status, estimate = compiled("find_templates")(
        **{"frames": frames, "start": start, "samples": samples, "numbers": numbers, "variance": variance},
        **{"place": place, "speed": speed, "steps": total // recordings if place.shape[0] else 1},
        **{"window": math.isqrt(samples.shape[-1]), "rounds": rounds, "rounding": rounding},
        **{"forward_backward_limit": forward_backward_limit, "mismatch_limit": mismatch_limit},
    )
    return points, error, covariance, status, estimate, place, speed


def sizes_of(window: int, radius: int) -> tuple[int, int]:
    """Return the side (odd) of the template of an exhaustive search and the search radius, in px at half resolution,
    from the tracking window and the search radius at full resolution.

    `window` is the side of the tracking window and `radius` that of the search in x and y, px at full resolution.

    Raises:
        ValueError: a window below 1 px, a negative radius, or a search wider than 32768 px.
    """
    size, reach = 2 * (min(_WIDENING * window, window + 2 * radius) // 4) + 1, (radius + 1) // 2
    if window < 1 or radius < 0 or size + 2 * reach > _WIDEST_SEARCH:
        raise ValueError(f"a search of {window} px windows within {radius} px: 1 px or more, {_WIDEST_SEARCH} in all")
    return size, reach


def correct_points(
    start: Array, points: Array, covariance: Array, numbers: Array, inverse_warp: Array, *, window: int, gauge_px: float
) -> CorrectedPoints:
    """Correct the positions of N points tracked in K frames for the deformation of the skin, estimated from the points,
    as `ops.tracking.deformation` up to rounding.

    Args:
        start: (N, 2) px in the key frame.
        points: (K, N, 2) px as they were found, NaN where they were not, and their covariance (K, N, 2, 2) px^2.
        covariance: see `points`.
        numbers: (N, 32) template statistics.
        inverse_warp: (N, 2, 2) inverse of the deformation gradient with which the templates were prepared.
        window: px, side of a template, 3 or more.
        gauge_px: diameter of the local fits.
    """
    if not gauge_px > 0:
        raise ValueError(f"a gauge length of {gauge_px} px: give a length")
    radius = gauge_px / 2
    limits = {"minimum_points": MINIMUM_POINTS, "radius": radius, "least_spread": MINIMUM_SPREAD * radius}
    tracked = {"start": start, "found": points, "covariance": covariance}
    templates = {"numbers": numbers, "inverse_warp": inverse_warp, "window": window}
    return CorrectedPoints(*compiled("correct_points")(**tracked, **templates, **limits))


def find_neighbours(positions: NDArray[Any], gauge_length: float) -> tuple[NDArray[Any], ...]:
    """Find the k nearest neighbours of each of N points for the outlier detection, once for all frames of the points.

    Return them nearest first as arrays (k, P), P the smallest multiple of 16 that is not below N: their numbers
    (int32), their offsets from the point in x and in y (float32, 0 where the neighbour does not count), and float32, 1
    where a neighbour is known and lies no farther away than half the gauge length, else 0.

    Args:
        positions: (N, 2) reference positions, float32, NaN where there is none. N is 2 or more.
        gauge_length: diameter around a point in which neighbours count, in the unit of the positions.

    Raises:
        ValueError: fewer than 2 points.
    """
    count = len(positions)
    if count < 2:
        raise ValueError(f"{count} points have no neighbours: give 2 or more")
    most = min(outlier_limits.NEIGHBOURS, count - 1)
    number = np.zeros((most, -(-count // _LANES) * _LANES), np.int32)
    x, y, within = (np.zeros(number.shape, np.float32) for _ in range(3))
    for first in range(0, count, _ROWS):
        rows = np.arange(first, min(first + _ROWS, count))
        away_x, away_y = (positions[:, k] - positions[rows, k, None] for k in range(2))
        distance = away_x * away_x + away_y * away_y
        near = distance <= np.float32((gauge_length / 2) ** 2)  # False for NaN
        near[rows - first, rows] = False
        distance[~near] = np.inf
        # Sort by distance, then by index: bit patterns of non-negative floats have the order of the floats.
        order = (distance.view(np.int32).astype(np.int64) << 32) + np.arange(count)
        nearest = np.sort(np.partition(order, most - 1, axis=1)[:, :most], axis=1) & 0xFFFFFFFF
        counts = np.take_along_axis(near, nearest, 1)
        number[:, rows], within[:, rows] = nearest.T, counts.T
        for offset, away in ((x, away_x), (y, away_y)):
            offset[:, rows] = np.where(counts, np.take_along_axis(away, nearest, 1), np.float32(0)).T
    return number, x, y, within


def find_outliers(
    neighbours: tuple[NDArray[Any], ...], displacement: NDArray[Any], position_std: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return masks (K, N) of outliers among N points in K frames: of those that deviate from their neighbours in
    displacement, and of those far more uncertain than their neighbours, as `ops.find_outliers`.

    A point at a limit, to the rounding of float32, may have another result than there.

    Args:
        neighbours: from :func:`find_neighbours`, for all frames.
        displacement: (K, N, 2) in the unit of the positions; NaN where it is unknown.
        position_std: (K, N), standard deviation of a component.
    """
    count = displacement.shape[1]
    number, x, y, within = neighbours
    if number.shape[1] != -(-count // _LANES) * _LANES:
        raise ValueError(f"{count} points, and neighbours of up to {number.shape[1]}")
    return compiled("find_outliers")(
        **{"number": number, "x": x, "y": y, "within": within},
        displacement=displacement,
        deviation=position_std,
        spread=outlier_limits.SPREAD,
        ridge=outlier_limits.RIDGE,
        least_deviation=outlier_limits.LEAST_DEVIATION,
        most_disagreement=outlier_limits.MOST_DISAGREEMENT,
        most_uncertainty=outlier_limits.MOST_UNCERTAINTY,
        least_neighbours=outlier_limits.LEAST_NEIGHBOURS,
    )
