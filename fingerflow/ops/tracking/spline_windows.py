"""Sampling of spline windows around points, by batched matrix products of pixel patches with B-spline weights.

A window at a shift s from a whole pixel is B_y(s) p B_x(s)^T, with the patch of pixels p. B is a band matrix of the
weights of s: those of the cubic B-spline, convolved with the smoothing that yields its coefficients
(`ops.filters.spline`). No image of coefficients is formed. The weights at the whole positions -2 to 2 are functions of
the shift within (-1, 1): with u = max(2 - |x|, 0) and v = max(1 - |x|, 0) the B-spline is b3(x) = (u^3 - 4 v^3) / 6.

`kernels/templates.cpp` contains the compiled forms.
"""

import torch
from torch import Tensor
from torch.nn import functional

from fingerflow.ops.branching import may_branch
from fingerflow.ops.filters.windows import take_lines
from fingerflow.ops.tensors import bordered

MARGIN = 3  # px of a patch on each side of its window: two for the support of the spline, one for the smoothing
TAPS = 5


def cut_patches(view: Tensor, center: Tensor, size: int, dtype: torch.dtype) -> Tensor:
    """Cut square patches (P, side, side) from images (B, 1, H, W), centred on whole pixels (B, 2, N); they hold a
    window of `size` px and 3 px more on every side.

    P = B N and side = size + 6; pixels are (x, y). The border is replicated; a window that would reach beyond the
    replicated border is moved inwards.
    """
    side = size + 2 * MARGIN
    # Copy uint8 without conversion, which takes a quarter of the memory.
    border = max(MARGIN + 2, side - min(view.shape[-2:]))  # a window that was found inside may need a pixel outside
    exporting = torch.compiler.is_exporting()
    plane = bordered(view if view.dtype == torch.uint8 else view.to(dtype), border)
    height, width = plane.shape[-2:]
    column, row = (center + (border - side // 2)).split(1, dim=1)
    # Clamp as floats, since ONNX runtimes need two nodes to clamp integers.
    first = row.clamp(0.0, float(height - side)) * width + column.clamp(0.0, float(width - side))
    # Add one index per window and one per pixel. Adding indices of rows and columns takes ONNX runtimes three times as
    # long.
    whole = torch.int32 if exporting else torch.int64
    first = first.to(whole).transpose(1, 2)
    steps = torch.arange(side, dtype=whole, device=view.device)
    if exporting or view.requires_grad:
        index = first + (steps[:, None] * width + steps).flatten()
        pixels = plane.flatten(1).gather(1, index.flatten(1))
    else:
        first_pixel = torch.arange(len(plane), device=view.device)[:, None, None] * (height * width)
        pixels = take_lines(plane, first + first_pixel + steps * width, side)
    return pixels.to(dtype).reshape(-1, side, side)


def taps(shift: Tensor) -> Tensor:
    """Return the five cubic B-spline weights (..., 5) of the coefficients at -2 to 2, for a position `shift` (...)."""
    return taps_and_slopes(shift)[0]


def taps_and_slopes(shift: Tensor) -> tuple[Tensor, Tensor]:
    """Return the five weights of `taps`, and their derivatives, (..., 5) each."""
    offsets = shift[..., None] - torch.arange(-2, 3, dtype=shift.dtype, device=shift.device)
    u = (2 - offsets.abs()).clamp_min(0)
    v = (u - 1).clamp_min(0)
    return (u * u * u - 4 * v * v * v) / 6, (2 * v * v - u * u / 2) * offsets.sign()


def cut_windows(shift: Tensor, patches: Tensor, size: int) -> Tensor:
    """Sample the spline on windows (P, size size), shifted by (P, 2) px from the centres of patches (P, side, side)."""
    weights = taps(shift)
    if may_branch(patches, shift) and len(patches):
        # A grouped convolution takes torch half the time of matrix products, and ONNX Runtime five times as long.
        weights = weights @ _smoothed(weights)
        both = weights[:, 1, :, None] * weights[:, 0, None, :]
        windows = functional.conv2d(patches[None], both[:, None], groups=len(patches)).squeeze(0)
    else:
        windows = along_y(weights[:, 1], size) @ patches @ along_x(weights[:, 0], size)
    return windows.flatten(1)


def along_y(weights: Tensor, size: int) -> Tensor:
    """Return the matrices (..., size, side) that turn pixel columns of a patch into spline samples of a window along y,
    given five B-spline `weights` (..., 5).

    `weights` (..., 5) are the taps of the y shift.
    """
    side = size + 2 * MARGIN
    # Make each line of the band one element longer than a matrix row, so that the next one starts one column later in
    # its row.
    line = functional.pad(_smoothed(weights), (0, side + 1 - TAPS - 2))
    bands = line[:, None].expand(TAPS, size, side + 1).flatten(1)[:, : size * side]
    return (weights @ bands).unflatten(-1, (size, side))


def along_x(weights: Tensor, size: int) -> Tensor:
    """Return the matrices (..., side, size) that turn pixel rows of a patch into spline samples of a window along x,
    given five B-spline `weights` (..., 5).

    `weights` (..., 5) are the taps of the x shift.
    """
    return along_y(weights, size).transpose(-1, -2)


def onto_pixels(weights: Tensor, size: int) -> Tensor:
    """Convert weights (..., size, size) of the spline samples of a window to weights (..., side, side) of the pixels of
    its patch, which give the same weighted sum.
    """
    middle = along_y(taps(weights.new_zeros(())), size)
    return middle.T @ weights @ middle


def _smoothed(like: Tensor) -> Tensor:
    """Return the matrix (5, 7) that converts five weights of spline coefficients to seven weights of pixels, as
    coefficients are pixels smoothed by (1, 2, 1) / 4.
    """
    offset = torch.arange(TAPS + 2, device=like.device) - torch.arange(TAPS, device=like.device)[:, None]
    middle, sides = (offset == 1).to(like.dtype), ((offset == 0) | (offset == 2)).to(like.dtype)
    return middle / 2 + sides / 4
