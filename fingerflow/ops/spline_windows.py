"""Windows around points as batched products: patches of pixels, and their spline at a fractional shift.

A window at a shift s from a whole pixel is B_y(s) p B_x(s)^T, p its patch of pixels and B the matrix with the weights
of s along its band: those of the cubic B-spline spread by the smoothing that its coefficients ask for (`ops.spline`).
No image of coefficients is formed. The weights at the whole places -2 to 2 are functions of the shift within (-1, 1):
with u = max(2 - |x|, 0) and v = max(1 - |x|, 0) the B-spline is b3(x) = (u^3 - 4 v^3) / 6.
"""

import torch
from torch import Tensor

MARGIN = 3  # px of a patch around its window: two of the spline at the reach, one of the smoothing
TAPS = 5
_SMOOTHING = (0.25, 0.5, 0.25)


def cut_patches(view: Tensor, center: Tensor, size: int, dtype: torch.dtype) -> Tensor:
    """Pixels (P, side, side) of views (B, 1, H, W) around whole pixels (B, 2, N), x first; P = B N, side = size + 6.

    Pixels beyond the border repeat the border.
    """
    height, width = view.shape[-2:]
    side = size + 2 * MARGIN
    steps = torch.arange(side, device=view.device, dtype=center.dtype) - side // 2
    column = (center[:, 0, :, None] + steps).clamp(0, width - 1)
    row = (center[:, 1, :, None] + steps).clamp(0, height - 1)
    index = (row[..., None] * width + column[..., None, :]).to(torch.int64)  # exact below 2^24
    # Bytes are gathered as they are, a quarter of the memory; torch gathers no uint16.
    plane = view if view.dtype == torch.uint8 else view.to(dtype)
    return plane.flatten(1).gather(1, index.flatten(1)).to(dtype).reshape(-1, side, side)


def taps(shift: Tensor) -> Tensor:
    """b3(shift - place) at the five places, (..., 5) of shifts (...)."""
    return _values(*_distances(_from_places(shift)))


def taps_and_slopes(shift: Tensor) -> tuple[Tensor, Tensor]:
    """The same, and its derivatives."""
    beside = _from_places(shift)
    u, v = _distances(beside)
    return _values(u, v), (2 * v * v - u * u / 2) * beside.sign()


def along_y(weights: Tensor, size: int) -> Tensor:
    """(..., size, side): from the pixels of a column to the spline on a window, for taps (..., 5) of the shift in y."""
    return (weights @ _bands(size, weights).flatten(1)).unflatten(-1, (size, size + 2 * MARGIN))


def along_x(weights: Tensor, size: int) -> Tensor:
    """(..., side, size): the same for a line."""
    return (weights @ _bands(size, weights).transpose(1, 2).flatten(1)).unflatten(-1, (size + 2 * MARGIN, size))


def onto_pixels(weights: Tensor, size: int) -> Tensor:
    """(..., side, side): what weights (..., size, size) of the spline at whole pixels are of the pixels themselves."""
    middle = along_y(taps(weights.new_zeros(())), size)
    return middle.T @ weights @ middle


def _bands(size: int, like: Tensor) -> Tensor:
    """(5, size, side): where each tap finds its smoothed pixel."""
    side = size + 2 * MARGIN
    beyond = torch.arange(side, device=like.device) - torch.arange(size, device=like.device)[:, None]
    tap = torch.arange(TAPS, device=like.device)[:, None, None]
    smoothed = [weight * (beyond == tap + offset).to(like.dtype) for offset, weight in enumerate(_SMOOTHING)]
    return smoothed[0] + smoothed[1] + smoothed[2]


def _from_places(shift: Tensor) -> Tensor:
    return shift[..., None] - torch.arange(-2, 3, dtype=shift.dtype, device=shift.device)


def _distances(beside: Tensor) -> tuple[Tensor, Tensor]:
    u = (2 - beside.abs()).clamp_min(0)
    return u, (u - 1).clamp_min(0)


def _values(u: Tensor, v: Tensor) -> Tensor:
    return (u * u * u - 4 * v * v * v) / 6
