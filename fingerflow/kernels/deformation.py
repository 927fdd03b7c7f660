"""Kernel that corrects tracked points for the deformation of the skin."""

from typing import Generic, NamedTuple

from fingerflow.kernels.arrays import Array, empty
from fingerflow.kernels.checks import check_axes, checked
from fingerflow.kernels.field_limits import MINIMUM_POINTS, MINIMUM_SPREAD
from fingerflow.kernels.library import entry, threads
from fingerflow.kernels.tracking_limits import NUMBERS


class CorrectedPoints(NamedTuple, Generic[Array]):
    """Tracked points (N points in K frames) after correction for the deformation of the skin.

    Attributes:
        points: (K, N, 2) px.
        covariance: (K, N, 2, 2) px^2, without the part of the residual that is due to the deformation.
        warp: (K, N, 2, 2) deformation gradient since the key frame; the identity where it is not known.
        shift: (K, N) px by which the deformation has moved the edge of a window since its template was prepared.
        expected: (K, N, 2) px, position predicted from the neighbours of a point; NaN where too few are known.
    """

    points: Array
    covariance: Array
    warp: Array
    shift: Array
    expected: Array


def correct_points(
    start: Array,
    points: Array,
    covariance: Array,
    numbers: Array,
    inverse_warp: Array,
    *,
    window: int,
    gauge_px: float,
) -> CorrectedPoints[Array]:
    """Correct the positions of N points tracked in K frames for the deformation of the skin, estimated from the points,
    as `ops.tracking.deformation` up to rounding.

    Args:
        start: (N, 2) px in the key frame, float32 as all arrays.
        points: (K, N, 2) px as they were found, NaN where they were not, and their covariance (K, N, 2, 2) px^2.
        covariance: see `points`.
        numbers: (N, 32) template statistics.
        inverse_warp: (N, 2, 2) inverse of the deformation gradient with which the templates were prepared.
        window: px, side of a template.
        gauge_px: diameter of the local fits.

    Raises:
        ValueError: wrong dtype or shape.
    """
    check_axes("start", start, 2)
    check_axes("points", points, 3)
    frames, count = points.shape[0], start.shape[0]
    if window < 3 or not gauge_px > 0:
        raise ValueError(
            f"a window of {window} px and a gauge length of {gauge_px} px: give 3 px or more, and a length"
        )
    shapes = ((count, 2), (count, 2, 2), (count, 2, 2), (count,), (count, 2))
    result = CorrectedPoints(*(empty(points, "float32", frames, *shape) for shape in shapes))
    entry("correct_points")(
        start=checked("start", start, "float32", (count, 2)),
        found=checked("points", points, "float32", (frames, count, 2)),
        covariance=checked("covariance", covariance, "float32", (frames, count, 2, 2)),
        numbers=checked("numbers", numbers, "float32", (count, NUMBERS)),
        inverse_warp=checked("inverse_warp", inverse_warp, "float32", (count, 2, 2)),
        corrected=result.points,
        remaining=result.covariance,
        warp=result.warp,
        shift=result.shift,
        expected=result.expected,
        frames=frames,
        points=count,
        window=window,
        minimum_points=MINIMUM_POINTS,
        radius=gauge_px / 2,
        least_spread=MINIMUM_SPREAD * gauge_px / 2,
        threads=threads(),
    )
    return result
