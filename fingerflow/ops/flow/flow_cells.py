"""Convert dense-flow fields between pixels and cells of 2 x 2 px, and compute on cells.

The windows that integrate the data term, and the smoothing, pass almost nothing below a period of 4 px: less than 1e-7
of the height of a wave, for a window of two boxes of 9 px and a smoothing length of 7 px. One unknown per cell and
component is thus enough, and everything except the images costs a fourth. Errors are the same as with one unknown per
pixel: 0.0182 and 0.0183 px on a whorl, 0.1533 and 0.1536 on a real picture with windows of 3 px.

At pixels the flow is its best-fitting plane, plus the remainder interpolated bilinearly between the centres of known
cells. The trend of the flow, the departure from which the smoothness term penalises, lies on cells too.

Planes are fitted by weighted least squares, in closed form from the moments of the positions. `kernels/flow_cells.cpp`
contains the compiled forms, `kernels/flow_course.cpp` that of the trend.
"""

import math

import torch
from torch import Tensor
from torch.nn import functional

CELL = 2  # px, side of a cell
_NARROW = 0.01  # least determinant of the second moments in a plane fit, relative to the squared trace; 1/4 for a disc
_TINY = 1e-12


# Planes fitted to the two components of a flow, each (B, 2, ., .): height at the origin, slope along x, slope along y.
Planes = tuple[Tensor, Tensor, Tensor]


def evaluated(plane: Planes, x: Tensor, y: Tensor) -> Tensor:
    """Return the values of planes at positions (x, y)."""
    height, slope_x, slope_y = plane
    return height + slope_x * x + slope_y * y


def halved(fields: Tensor) -> Tensor:
    """Halve fields by averaging blocks of 2 x 2 cells: return (B, C, ceil(h / 2), ceil(w / 2)).

    Values beyond the border count as 0.
    """
    height, width = fields.shape[-2:]
    return functional.avg_pool2d(functional.pad(fields, (0, width % 2, 0, height % 2)), 2)


def magnified(fields: Tensor, times: int) -> Tensor:
    """Interpolate fields on cells bilinearly to `times` as many cells along each axis; the border is replicated."""
    return functional.interpolate(fields, scale_factor=times, mode="bilinear", align_corners=False)


def spread(cells: Tensor, valid: Tensor, height: int, width: int) -> Tensor:
    """Interpolate fields bilinearly from the cells where they are `valid` to the `height` x `width` elements of a grid
    of half the spacing: smaller cells, or pixels.

    Fields (B, C, h, w) become (B, C, height, width). `valid` is 1 or 0. The four nearest cells have the weights 9/16,
    3/16, 3/16 and 1/16. The result is 0 where none of them is known.
    """
    both = magnified(torch.cat((torch.where(valid > 0, cells, 0.0), valid), dim=1), CELL)[..., :height, :width]
    share = both[:, -1:]
    return both[:, :-1] / torch.where(share > 0, share, 1.0)


def to_cells(pixels: Tensor, inside: Tensor) -> Tensor:
    """Average a field (B, 2, H, W) over the pixels of a mask in each cell of 2 x 2 px.

    The mask `inside` (B, 1, H, W) is 1 or 0. Non-finite values count as 0; a cell without a pixel inside is 0.
    """
    return _sums(inside * pixels.nan_to_num(0.0, 0.0, 0.0)) / _sums(inside).clamp_min(1)


def _sums(fields: Tensor) -> Tensor:
    """Return the sums of fields over blocks of 2 x 2 elements; beyond the border fields are 0.

    Strided slices take a third of the time of `avg_pool2d` on one core.
    """
    height, width = fields.shape[-2:]
    even = functional.pad(fields, (0, width % 2, 0, height % 2)) if height % 2 or width % 2 else fields
    rows = even[..., ::2, :] + even[..., 1::2, :]
    return rows[..., ::2] + rows[..., 1::2]


def to_pixels(cells: Tensor, valid: Tensor, height: int, width: int) -> Tensor:
    """Interpolate a flow (B, 2, h, w) from cells to pixels: return (B, 2, height, width).

    `valid` (B, 1, h, w) is 1 for known cells, else 0.
    """
    plane = fit_plane(cells, valid)
    departure = spread(cells - evaluated(plane, *positions(cells)), valid, height, width)
    return evaluated(plane, *positions(cells, height, width)) + departure


def fit_plane(cells: Tensor, valid: Tensor) -> Planes:
    """Fit one plane (B, 2, 1, 1) to a whole field on cells (B, 2, h, w), with the weights `valid`."""
    return planes(moments(valid, valid * cells, *positions(cells)).sum((2, 3), keepdim=True))


def positions(cells: Tensor, *size: int) -> tuple[Tensor, Tensor]:
    """Return the coordinates x (w) and y (h, 1) of cells (., ., h, w), or those of the pixels of their frame of the
    `size` (height, width), in units of a cell from the centre of the field of cells.
    """
    side = CELL if size else 1
    y, x = (
        (torch.arange(count, dtype=cells.dtype, device=cells.device) - (side - 1) / 2) / side - (number - 1) / 2
        for count, number in zip(size or cells.shape[-2:], cells.shape[-2:], strict=True)
    )
    return x, y[:, None]


def moments(share: Tensor, field: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Return the moments (B, 12, h, w) from which `planes` fits planes to a flow: at each cell the weight `share` times
    1, x, y, x^2, x y and y^2, and the weighted flow `field` times 1, x and y.

    The weights are (B, 1, h, w).
    """
    along, down = share * x, share * y
    return torch.cat((share, along, down, along * x, along * y, down * y, field, field * x, field * y), dim=1)


def planes(moments: Tensor) -> Planes:
    """Fit planes to the two components of a flow by weighted least squares, given the `moments` of the flow, summed or
    averaged over the cells that each plane shall fit.

    A plane is the mean where cells do not span it, and 0 where there are no cells.
    """
    around, *sums = moments.split((1, 1, 1, 1, 1, 1, 2, 2, 2), dim=1)
    count = torch.where(around > _TINY, around, 1.0)
    mean_x, mean_y, xx, xy, yy, mean, by_x, by_y = (total / count for total in sums)
    xx, xy, yy = xx - mean_x * mean_x, xy - mean_x * mean_y, yy - mean_y * mean_y
    by_x, by_y = by_x - mean_x * mean, by_y - mean_y * mean
    determinant = xx * yy - xy * xy
    spanned = (determinant > _NARROW * (xx + yy).square()) & (determinant > _TINY)
    determinant = torch.where(spanned, determinant, torch.inf)
    slope_x, slope_y = (by_x * yy - by_y * xy) / determinant, (by_y * xx - by_x * xy) / determinant
    return mean - slope_x * mean_x - slope_y * mean_y, slope_x, slope_y


def window(side: float) -> list[float]:
    """Return the weights of a window along a line of cells: two successive box means, each `side` >= 1 cells wide."""
    reach = math.ceil((side - 1) / 2 - 1e-9)
    ends = (side - (2 * reach - 1)) / 2
    once = [1.0] if reach == 0 else [ends / side, *[1 / side] * (2 * reach - 1), ends / side]
    return [
        sum(once[j] * once[k - j] for j in range(len(once)) if 0 <= k - j < len(once)) for k in range(2 * len(once) - 1)
    ]


def window_variance(weights: list[float]) -> float:
    """Return the variance, px^2, of a window of weights along one axis, including the extent of a cell."""
    half = len(weights) // 2
    spread_out = sum(weight * (k - half) ** 2 for k, weight in enumerate(weights))
    return CELL**2 * spread_out + (CELL**2 - 1) / 12


def integrated(fields: Tensor, weights: list[float]) -> Tensor:
    """Return weighted means of fields (B, C, h, w) over a window, with the weights applied along x and along y.

    Values beyond the border count as 0.
    """
    half = len(weights) // 2
    for dim, pads in ((2, (0, 0, half, half)), (3, (half, half))):
        wide, length = functional.pad(fields, pads), fields.shape[dim]
        total = weights[half] * fields
        for k in range(half):
            total = total + weights[k] * (wide.narrow(dim, k, length) + wide.narrow(dim, 2 * half - k, length))
        fields = total
    return fields


COURSE_WINDOW = window(9)  # weights over cells of 4 px


def trend(flow: Tensor, valid: Tensor) -> Tensor:
    """Return the trend (B, 2, h, w) of a flow on cells: a smooth part, locally a plane, which the smoothness term of
    dense flow does not penalise.

    `valid` (B, 1, h, w) is 1 for cells that contribute, else 0. The trend is the best-fitting plane, plus planes fitted
    to the remainder around every position, in two successive boxes of 36 px.
    """
    whole = evaluated(fit_plane(flow, valid), *positions(flow))
    share = halved(valid)
    x, y = positions(share)
    around = planes(integrated(moments(share, halved(valid * (flow - whole)), x, y), COURSE_WINDOW))
    return whole + magnified(evaluated(around, x, y), 2)[..., : flow.shape[-2], : flow.shape[-1]]
