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

_SIDE = 48  # px, side of the picture in which the nearest points are searched
_FEWEST = 3  # least number of points


def median_over_area(
    position: Array, displacement: Array, variance: Array, ellipse: FrameEllipse, reach_mm: float
) -> tuple[Array, Array]:
    """Return the medians (n, 2) mm of displacements over the area of the contact, by component, and their standard
    deviations (n, 2) mm.

    Each part of the area counts with the displacement of the nearest point, up to `reach_mm` from it, in lengths that
    the axes of the ellipse scale. A median over the points would differ, since they crowd where skin has texture. As
    for the fields (`ops.fields.area_medians`), a median is NaN where less than 0.85 of the area is known, and where
    there is no contact.

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
    # In the frame of the ellipse, of which the unit disc is the contact, on pixels; each component separately, as NumPy
    # is slow over an axis of two.
    right, down = (position[..., k] - ellipse.center[:, k : k + 1] for k in (0, 1))
    cosine, sine = np.cos(ellipse.angle)[:, None], np.sin(ellipse.angle)[:, None]
    turned = right * cosine + down * sine, down * cosine - right * sine
    axes, disc = ellipse.semi_axes, _disc()
    scaled = [along / axes[:, k : k + 1] * (_SIDE / 2 - 1) + (_SIDE - 1) / 2 for k, along in enumerate(turned)]
    finite = np.isfinite(displacement[..., 0] + displacement[..., 1] + variance + scaled[0])
    columns, rows = (np.rint(np.where(finite, values, -1)).astype(np.int32) for values in scaled)
    known = finite & (columns >= 0) & (columns < _SIDE) & (rows >= 0) & (rows < _SIDE)
    reach = reach_mm / np.sqrt(axes[:, 0] * axes[:, 1]) * (_SIDE / 2 - 1)  # px
    rim = 1 - np.maximum(axes - BORDER_MM, 0).prod(1) / axes.prod(1)
    for frame in (known.sum(1) >= _FEWEST).nonzero()[0]:
        points = known[frame].nonzero()[0]
        pixels = rows[frame, points], columns[frame, points]
        picture = np.ones((_SIDE, _SIDE), np.uint8)
        picture[pixels] = 0
        distance, label = cv2.distanceTransformWithLabels(picture, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
        counted = label.ravel()[disc & (distance.ravel() < reach[frame])]
        share = len(counted) / disc.sum()
        if share < LEAST_SHARE:
            continue
        # Two points in one pixel: the label is that of both, and the last of them takes the area.
        area = np.bincount(counted, minlength=len(points) + 1)
        labelled = np.zeros(len(area), int)
        labelled[label[pixels]] = points
        points, area = labelled[area > 0], area[area > 0]
        unknown = (1 - share) / (2 * share)
        ranks = math.sqrt((rim[frame] / 2) ** 2 + unknown**2 / 3 + len(points) ** -1.5 / 6)
        of_points, looked_up = variance[frame, points], (0.5 - ranks, 0.5, 0.5 + ranks)
        for component, values in enumerate(displacement[frame, points].T):
            order = values.argsort()
            parts = area[order]
            low, middle, high = np.interp(looked_up, (parts.cumsum() - parts / 2) / len(counted), values[order])
            half = (high - low) / 2
            # Tukey's biweight about the median: 1 - z^2, squared.
            near = (values - middle) ** 2 / (of_points + half**2 + 1e-30)
            weight = area * np.maximum(1 - near / REACH**2, 0) ** 2
            noise = weight @ (weight * of_points) / max(np.add.reduce(weight), 1e-30) ** 2
            median[frame, component], deviation[frame, component] = middle, math.sqrt(noise + half**2)
    return median, deviation


@functools.cache
def _disc() -> NDArray[np.bool_]:
    """Return the mask (px,) of the pixels in the unit disc, which is the contact."""
    row, column = np.indices((_SIDE, _SIDE)) - (_SIDE - 1) / 2
    return (row**2 + column**2 < (_SIDE / 2 - 1) ** 2).ravel()
