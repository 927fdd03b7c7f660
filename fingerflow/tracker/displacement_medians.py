"""Median displacement over the area of the contact, and its standard deviation."""

import numpy as np

from fingerflow.kernels import field_limits as limits
from fingerflow.kernels.array_types import Array
from fingerflow.kernels.library import compiled, is_present
from fingerflow.kernels.result_records import FrameEllipse
from fingerflow.tracker.contact_border import BORDER_MM

_TINY = 1e-30


def displacement_medians(
    position: Array, displacement: Array, variance: Array, ellipse: FrameEllipse, reach: float
) -> tuple[Array, Array]:
    """Return the median displacements (n, 2) mm over the area of the contact in n frames, by component, from those of N
    points, and their standard deviations (n, 2) mm.

    Each part of the area counts with the displacement of the nearest point, up to `reach` from it, in lengths that the
    axes of the ellipse scale. A median over the points would differ, since they crowd where skin has texture. As for
    the fields (`area_medians`), a median is NaN where less than 0.85 of the area is known, and where there is no
    contact.

    The deviation is half the difference of the quantiles at 1/2 +- d, with what errors of the points near the median
    add (Tukey's biweight about the median, squared). d^2 is the sum of the squares of three ranks, as shares of the
    area: half of the rim as wide as the deviation of the border's position; (1 - s) / (2 s sqrt(3)) for a known share
    s, as the median of all may lie anywhere between; and sqrt(sqrt(N) / 6) / N for N points, 2 sqrt(N) of whose areas
    the line of the median crosses anywhere.

    Compiled twin: `kernels/displacement_medians.cpp`.

    Args:
        position: (n, N, 2) float64 mm.
        displacement: (n, N, 2) float64 mm, NaN where it is not known.
        variance: (n, N) float64 mm^2 of a component of it.
        ellipse: of the apparent contact in these frames, float64, mm.
        reach: mm, largest distance to the nearest point.
    """
    center, axes, angle = ellipse
    ellipses = np.concatenate((center, axes, np.cos(angle)[:, None], np.sin(angle)[:, None]), axis=1)
    points = {"position": position, "displacement": displacement, "variance": variance, "ellipses": ellipses}
    if is_present():
        area = {"lattice": limits.lattice(), "least_share": limits.LEAST_SHARE, "beside": limits.REACH}
        return compiled("displacement_medians")(**points, **area, reach=reach, border=BORDER_MM)
    medians, deviations = np.full((2, len(position), 2), np.nan)
    for frame, values in enumerate(zip(position, displacement, variance, ellipses, strict=True)):
        medians[frame], deviations[frame] = _of_frame(*values, reach)
    return medians, deviations


def _of_frame(
    position: Array, displacement: Array, variance: Array, ellipse: Array, reach: float
) -> tuple[Array | float, Array | float]:
    """Return the medians (2,) and deviations (2,) of a frame; `ellipse` (6,) has centre, axes, cosine and sine."""
    axes, (cosine, sine) = ellipse[2:4], ellipse[4:]
    known = np.isfinite(position.sum(1) + displacement.sum(1) + variance)
    if not (np.isfinite(ellipse).all() and (axes > 0).all() and known.any()):
        return np.nan, np.nan
    displacement, variance, (right, down) = displacement[known], variance[known], (position[known] - ellipse[:2]).T
    on_disc = np.stack((right * cosine + down * sine, down * cosine - right * sine), axis=1) / axes
    across, down = map(np.subtract.outer, limits.lattice().T, on_disc.T)
    square = across * across + down * down
    nearest = square.argmin(1)[square.min(1) < reach**2 / axes.prod()]
    area = np.bincount(nearest, minlength=len(on_disc)).astype(np.float64)
    total, share = len(nearest), len(nearest) / len(square)
    if share < limits.LEAST_SHARE:
        return np.nan, np.nan
    counts = area > 0
    area, displacement, variance = area[counts, None], displacement[counts], variance[counts, None]
    rim = 1 - np.maximum(axes - BORDER_MM, 0).prod() / axes.prod()
    rank = np.sqrt((rim / 2) ** 2 + ((1 - share) / (2 * share)) ** 2 / 3 + len(area) ** -1.5 / 6)
    order = displacement.argsort(axis=0, kind="stable")
    ordered, parts = np.take_along_axis(displacement, order, axis=0).T, area[order, 0].T
    below, ranks = (parts.cumsum(1) - parts / 2) / total, 0.5 + rank * np.arange(-1, 2)
    low, middle, high = np.stack([np.interp(ranks, *column) for column in zip(below, ordered, strict=True)], axis=1)
    half = (high - low) / 2
    near = np.square(displacement - middle) / (variance + half**2 + _TINY)
    weight = area * np.square(np.maximum(1 - near / limits.REACH**2, 0))
    noise = (np.square(weight) * variance).sum(0) / np.square(np.maximum(weight.sum(0), _TINY))
    return middle, np.sqrt(noise + half**2)


def displacement_length(vector: Array, deviation: Array) -> tuple[Array, Array]:
    """Return the lengths (n,) of displacements `vector` (n, 2) and their standard deviations (n,), from the
    standard deviations (n, 2) of the components: that of the component along the displacement.
    """
    length = np.sqrt(vector[:, 0] ** 2 + vector[:, 1] ** 2)
    # Without a displacement its direction is unknown, and the error is that of any component.
    direction = np.where(length[:, None] > 0, vector / np.maximum(length, 1e-12)[:, None], 0.5**0.5)
    along = direction * deviation
    return length, np.sqrt(along[:, 0] ** 2 + along[:, 1] ** 2)
