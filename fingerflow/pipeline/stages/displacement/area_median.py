"""Median displacement over the area of the contact, and its standard deviation."""

from __future__ import annotations

import functools
import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fingerflow.kernels.field_limits import LEAST_SHARE, REACH
from fingerflow.kernels.result_records import FrameEllipse
from fingerflow.tracker.contact_border import BORDER_MM

Array = NDArray[Any]

_SIDE = 64  # px, side of the picture of a contact in which the nearest points are searched
_FEWEST = 3  # least number of points


def median_over_area(
    position: Array, displacement: Array, variance: Array, ellipse: FrameEllipse, reach_mm: float
) -> tuple[Array, Array]:
    """Return the medians (n, 2) mm of displacements over the area of the contact, by component, and their standard
    deviations (n, 2) mm.

    Each part of the area counts with the displacement of the nearest point, up to `reach_mm` from it. A median over the
    points would differ, since they crowd where skin has texture. As for the fields (`ops.fields.area_medians`), a
    median is NaN where less than 0.85 of the area is known, and where there is no contact.

    The deviation is half the difference of the quantiles at 1/2 +- d, with what errors of the points near the median
    add. d^2 is the sum of the squares of three ranks, as shares of the area: half of the rim as wide as the error of
    the border, `BORDER_MM`; (1 - s) / (2 s sqrt(3)) for a known share s, as the median of all may lie anywhere between;
    and sqrt(sqrt(N) / 6) / N for N points, 2 sqrt(N) of whose areas the line of the median crosses anywhere.

    Args:
        position: (n, N, 2) mm of the points.
        displacement: (n, N, 2) mm, NaN where it is not known.
        variance: (n, N) mm^2 of a component of it.
        ellipse: of the apparent contact in these frames, mm.
        reach_mm: largest distance to the nearest point.
    """
    median, deviation = np.full((2, len(position), 2), np.nan)
    for frame, (center, axes) in enumerate(zip(ellipse.center, ellipse.semi_axes, strict=True)):
        rows = np.isfinite(displacement[frame].sum(1) + position[frame].sum(1) + variance[frame]).nonzero()[0]
        if not axes.min() > 0 or len(rows) < _FEWEST:
            continue
        size = 2 * axes.max() / (_SIDE - 2)  # mm per px of the picture
        turned = ellipse.select(slice(frame, frame + 1))._replace(center=np.zeros((1, 2)))
        inside = turned.inside(_grid()[None] * size)[0] > 0
        pixels = np.rint((position[frame, rows] - center) / size + (_SIDE - 1) / 2).astype(int)
        within = ((pixels >= 0) & (pixels < _SIDE)).all(1)
        rows, (column, row) = rows[within], pixels[within].T
        if len(rows) < _FEWEST:
            continue
        picture = np.ones((_SIDE, _SIDE), np.uint8)
        picture[row, column] = 0
        distance, label = cv2.distanceTransformWithLabels(picture, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
        counted = inside & (distance.ravel() * size < reach_mm)
        share = counted.sum() / inside.sum()
        if share < LEAST_SHARE:
            continue
        # Two points in one pixel: the label is that of both, and the last of them takes the area.
        area = np.bincount(label.ravel()[counted], minlength=int(label.max()) + 1)
        points = np.zeros(len(area), int)
        points[label[row, column]] = rows
        points, area = points[area > 0], area[area > 0]
        rim = 1 - np.prod(np.maximum(axes - BORDER_MM, 0) / axes)
        ranks = math.sqrt(
            (rim / 2) ** 2 + ((1 - share) / (2 * share)) ** 2 / 3 + math.sqrt(len(points)) / 6 / len(points) ** 2
        )
        for component in range(2):
            values = displacement[frame, points, component]
            order = values.argsort()
            rank = (area[order].cumsum() - area[order] / 2) / area.sum()
            low, middle, high = np.interp((0.5 - ranks, 0.5, 0.5 + ranks), rank, values[order])
            of_points = variance[frame, points]
            near = np.square(values - middle) / (REACH**2 * (of_points + ((high - low) / 2) ** 2) + 1e-30)
            weight = area * np.square(np.maximum(1 - near, 0))
            noise = (weight**2 * of_points).sum() / max(weight.sum(), 1e-30) ** 2
            median[frame, component], deviation[frame, component] = (
                middle,
                math.hypot(math.sqrt(noise), (high - low) / 2),
            )
    return median, deviation


@functools.cache
def _grid() -> NDArray[np.float64]:
    """Return the pixel centres (px, 2) of the picture of a contact, px from its middle."""
    row, column = np.indices((_SIDE, _SIDE)) - (_SIDE - 1) / 2
    return np.stack((column, row), axis=-1).reshape(-1, 2)
