"""Reduce images to means over square cells, and interpolate between cells.

Cell (row i, column j) of side c px has its centre at (x, y) = (c j + (c - 1) / 2, c i + (c - 1) / 2) px.

Interpolation is bilinear. There are no twins of single functions: `kernels/apparent_contact.cpp` and
`kernels/covered.cpp` contain their compiled forms.
"""

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from fingerflow.ops.tensors import count_bytes


def cell_means(image: Tensor, cell: int, precision: torch.dtype = torch.float32) -> Tensor:
    """Compute the means of an image (B, 1, H, W) over cells of `cell` x `cell` px; the image is padded with zeros."""
    height, width = image.shape[-2:]
    # Add the lines of a mask as bytes, which hold sums up to 255: adding floats takes five times as long.
    values = count_bytes(image) if image.dtype == torch.bool and cell <= 255 else image.to(precision)
    if height % cell or width % cell:
        values = functional.pad(values, (0, -width % cell, 0, -height % cell))
    # Sum the columns first, by adding whole lines: torch adds slices faster than it reduces a short axis. ONNX runtimes
    # reduce.
    columns = add_all(values.unflatten(2, (-1, cell)).unbind(3)).to(precision).unflatten(3, (-1, cell))
    return (columns.sum(4) if torch.compiler.is_exporting() else add_all(columns.unbind(4))) / cell**2


def add_all(parts: Sequence[Tensor]) -> Tensor:
    """Return the elementwise sum of several tensors of equal shape and dtype, by pairwise summation."""
    while len(parts) > 1:
        parts = [first + second for first, second in zip(parts[::2], parts[1::2], strict=False)] + list(
            parts[len(parts) // 2 * 2 :]
        )
    return parts[0]


def largest_around(cells: Tensor) -> Tensor:
    """Return the maximum over the 3 x 3 cells around each cell, for cells (B, C, h, w) with values of at least 0."""
    if torch.compiler.is_exporting():  # half of the time there, and 13 times that of maxima of slices in torch
        return functional.max_pool2d(cells, 3, 1, 1)
    down = functional.pad(cells, (0, 0, 1, 1))
    down = torch.maximum(torch.maximum(down[..., :-2, :], down[..., 2:, :]), cells)
    along = functional.pad(down, (1, 1))
    return torch.maximum(torch.maximum(along[..., :-2], along[..., 2:]), down)


def enlarge(cells: Tensor, times: int) -> Tensor:
    """Enlarge an image on cells (B, 1, h, w): replace every cell by `times` x `times` equal cells."""
    return functional.interpolate(cells, scale_factor=times, mode="nearest")


def mask_of(density_margin: Tensor, cell: int, height: int, width: int) -> Tensor:
    """Return the mask (B, 1, height, width) bool of the pixels in the apparent contact: where `density_margin`,
    interpolated between cells of `cell` px, is positive.

    All pixels of an image column lie between the same two cell columns, so rows are interpolated first, then columns.
    """
    (left, right, across), (top, bottom, along) = (
        _between(density_margin, pixels, cells, cell)
        for pixels, cells in ((width, density_margin.shape[3]), (height, density_margin.shape[2]))
    )
    rows = density_margin[..., left] * (1 - across) + density_margin[..., right] * across
    along = along[:, None]
    return rows[..., top, :] * (1 - along) + rows[..., bottom, :] * along > 0


def _between(cells: Tensor, pixels: int, count: int, cell: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return, for each of `pixels` pixels along an axis of `count` cells of `cell` px, the indices of the two cells to
    interpolate between, and the weight of the second cell.

    The weight is the distance from the first cell, in cells; positions beyond the middle of the outermost cells are
    clamped to it, in the dtype of `cells`. Each result is (pixels,).
    """
    x = ((torch.arange(pixels, dtype=cells.dtype, device=cells.device) - (cell - 1) / 2) / cell).clamp(0, count - 1)
    first = x.floor().clamp(0, max(count - 2, 0))
    index = first.to(torch.int64)
    return index, index + min(1, count - 1), x - first
