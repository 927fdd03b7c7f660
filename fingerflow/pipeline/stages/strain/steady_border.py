"""Border of the contact, smoothed over frames in which it has moved by less than a ridge period.

The measured border runs between ridges, so that its error changes with the ridges that it reaches. On growing presses
the error of the mean radius has a standard deviation of 20 um, and 5 um when smoothed, about a mean of 12 um. Where a
border stops within few frames no parabola follows it, and it is as measured: smoothed, its radius would be up to 80 um
off.
"""

import numpy as np

from fingerflow.kernels.array_types import Series
from fingerflow.kernels.result_records import FrameEllipse

# mm, unit of the distance between borders: a border at a ridge period of 0.45 mm has a third of the weight.
_NEAR_MM = 0.3
_SECONDS, _FRAMES = 0.1, 64  # largest time (s) and number of frames before and after a frame that are fitted together
_DEGREE = 2  # degree of the polynomials in time
_ROUGH_MM = 0.025  # standard deviation of the mean radius about its polynomial above which the border is as measured


def steady_border(border: FrameEllipse, times: Series) -> FrameEllipse:
    """Return the ellipses of the contact border, smoothed by local fits over the times (n,) s of their frames; NaN
    where they are NaN.

    Centres and second moments of the ellipses are weighted by exp(-d^2 / 2), where d is the distance by which centre
    and mean radius differ from those of the frame.
    """
    major, minor = (border.semi_axes**2).T
    radius, half, turn = np.sqrt(border.semi_axes.prod(1)), (major - minor) / 2, 2 * border.angle
    moments = (major + minor) / 2, half * np.cos(turn), half * np.sin(turn)
    measured = np.column_stack((border.center, radius, *moments))
    fitted, scatter = _fit_over_time(measured, measured[:, :3] / _NEAR_MM, times / _SECONDS)
    fitted = np.where(scatter[:, 2:3] > _ROUGH_MM, measured, fitted)
    middle, along_x, along_diagonal = fitted[:, 3:].T
    half = np.hypot(along_x, along_diagonal)
    positive = (middle > half)[:, None]
    axes = np.sqrt(np.where(positive, np.stack((middle + half, middle - half), axis=1), border.semi_axes**2))
    angle = np.where(positive[:, 0], np.arctan2(along_diagonal, along_x) / 2, border.angle)
    return FrameEllipse(fitted[:, :2], axes, angle)


def _fit_over_time(values: Series, positions: Series, times: Series) -> tuple[Series, Series]:
    """Return `values` (n, V) smoothed over time, and their standard deviations (n, V) about the fits: each is fitted by
    a polynomial to the values at `times` (n,) less than 1 away, those with near `positions` (n, P) having more weight.
    """
    numbers = np.arange(len(values))
    reach = min(_FRAMES, int(np.max(np.searchsorted(times, times + 1, side="right") - numbers)))
    frames = numbers[:, None] + np.arange(-reach, reach + 1)
    inside = (frames >= 0) & (frames < len(values))
    frames = frames.clip(0, len(values) - 1)
    distance, since = ((positions[frames] - positions[:, None]) ** 2).sum(-1), times[frames] - times[:, None]
    near = inside & np.isfinite(distance) & (abs(since) < 1)
    powers = since[..., None] ** np.arange(_DEGREE + 1)
    weight = np.where(near, np.exp(-np.nan_to_num(distance) / 2), 0.0)
    weighed, nearby = weight[..., None] * powers, np.nan_to_num(values)[frames]
    # With fewer frames than coefficients, the solution of least norm is that of the frame itself.
    inverse = np.linalg.pinv(weighed.mT @ powers, hermitian=True)
    coefficients = inverse @ (weighed.mT @ nearby)
    square = (weight[..., None] * (nearby - powers @ coefficients) ** 2).sum(1)
    freedom = (weight * (1 - ((weighed @ inverse) * powers).sum(-1))).sum(1)
    scatter = np.sqrt(square / np.maximum(freedom, 1e-6)[:, None])
    return np.where(np.isfinite(values), coefficients[:, 0], np.nan), scatter
