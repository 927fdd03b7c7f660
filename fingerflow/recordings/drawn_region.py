"""Masks of the polygons and ellipses that a scene file draws in a view."""

import numpy as np
from numpy.typing import NDArray

from fingerflow.schema.views import Region


def drawn_mask(region: Region, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return the mask (h, w) of the pixels with centres inside a polygon, by the even-odd rule, or inside an ellipse.

    A centre on a left or an upper side of a polygon is inside, on a right or a lower side outside, so polygons that
    share a side share no pixel.
    """
    y, x = np.indices(shape)
    inside = np.zeros(shape, dtype=bool)
    if region.ellipse is not None:
        (right, down), (major, minor) = region.ellipse.center, region.ellipse.semi_axes
        cosine, sine = np.cos(region.ellipse.angle), np.sin(region.ellipse.angle)
        along, across = (x - right) * cosine + (y - down) * sine, (y - down) * cosine - (x - right) * sine
        inside = (along / major) ** 2 + (across / minor) ** 2 <= 1
    corners = region.polygon or ()
    for (x0, y0), (x1, y1) in zip(corners, (*corners[1:], *corners[:1]), strict=True):
        if y0 != y1:  # every pixel right of a side is once more inside or outside
            inside ^= ((y0 <= y) != (y1 <= y)) & (x >= x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return inside
