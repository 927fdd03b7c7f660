"""Rasterisation of polygons and ellipses in an image to horizontal runs of pixels, in pure Python, for both `process`
and streams.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

Point = tuple[float, float]


def region_runs(region: Mapping[str, Any], height: int, width: int) -> Iterator[tuple[int, int, int]]:
    """Yield the pixels inside a region, a polygon or an ellipse, in an image of `height` x `width` px, as runs (row,
    first column, end column).
    """
    if region["polygon"] is not None:
        yield from polygon_runs(region["polygon"], height, width)
    else:
        yield from ellipse_runs(**region["ellipse"], height=height, width=width)


def polygon_runs(corners: Sequence[Point], height: int, width: int) -> Iterator[tuple[int, int, int]]:
    """Yield the pixels with centres inside a closed polygon, by the even-odd rule, in an image of `height` x `width`
    px, as runs (row, first column, end column).

    Corners are (x, y) px with integers at pixel centres. A centre on a left or an upper side is inside, on a right or a
    lower side outside, so polygons that share a side share no pixel.
    """
    sides = list(zip(corners, (*corners[1:], corners[0]), strict=True))
    low, high = min(y for _, y in corners), max(y for _, y in corners)
    for row in range(max(0, math.ceil(low)), min(height, math.ceil(high))):
        crossings = sorted(
            x0 + (row - y0) * (x1 - x0) / (y1 - y0) for (x0, y0), (x1, y1) in sides if (y0 <= row) != (y1 <= row)
        )
        for left, right in zip(crossings[::2], crossings[1::2], strict=True):
            first, end = max(0, math.ceil(left)), min(width, math.ceil(right))
            if first < end:
                yield row, first, end


def ellipse_runs(
    center: Point, semi_axes: Point, angle: float, height: int, width: int
) -> Iterator[tuple[int, int, int]]:
    """Yield the pixels with centres inside an ellipse, in an image of `height` x `width` px, as runs (row, first
    column, end column).

    `angle` is that of the first axis, rad from x towards y. With x along the row, (p x + q y)^2 / a^2 + (p y - q x)^2 /
    b^2 <= 1 is a quadratic in x.
    """
    p, q = math.cos(angle), math.sin(angle)
    along, across = 1 / semi_axes[0] ** 2, 1 / semi_axes[1] ** 2
    square, mixed = p * p * along + q * q * across, p * q * (along - across)
    straight = q * q * along + p * p * across
    for row in range(height):
        y = row - center[1]
        root = mixed * mixed * y * y - square * (straight * y * y - 1)
        if root < 0:
            continue
        middle, half = center[0] - mixed * y / square, math.sqrt(root) / square
        first, end = max(0, math.ceil(middle - half)), min(width, math.floor(middle + half) + 1)
        if first < end:
            yield row, first, end
