"""Sampling of grey levels in deformed windows around points, for the comparison of windows of two images.

Samples are Keys' cubic convolution (1981) of the recorded pixels, not a spline. The comparison (`tracker.window_match`)
thus shares no arithmetic with the registration that found the points.

Compiled twin: `kernels/window_correlation.cpp`.
"""

import math

import torch
from torch import Tensor

from fingerflow.kernels.tensors import Twin, twin
from fingerflow.ops.contact.cells import add_all
from fingerflow.ops.filters.windows import taken

_compiled: Twin[Tensor] = twin("sample_windows")
_SHARPNESS = -0.75  # slope of the weights at 1 px, as in bicubic interpolation of torch and OpenCV


def sample_windows(images: Tensor, number: Tensor, places: Tensor, warp: Tensor, window: int, step: int) -> Tensor:
    """Sample the grey levels of images by cubic convolution in deformed windows, on a grid of spacing `step` px around
    each of the positions `places` (N, 2) px.

    Args:
        images: (n, 1, H, W).
        number: (N,) int64, index of the image of each window.
        places: (N, 2) px, centres of the windows.
        warp: (N, 2, 2), deformation applied to the grid of each window.
        window, step: px, side of a window and spacing of its grid.

    Returns:
        (N, m) of the dtype of `places`; NaN where a window does not lie at least 1 px inside the border of the image.
    """
    if _compiled.serves(images, number, places, warp) and min(images.shape[-2:]) >= 4:
        return _compiled(images, number, places, warp, window // 2, step)
    height, width = images.shape[-2:]
    steps = _steps(window, step, places)
    if min(height, width) < 4:
        return places.new_full((len(places), len(steps)), torch.nan)
    # Use positions relative to the pixel nearest to the centre: frame coordinates would lose two digits.
    center = places.round()
    (near_x, near_y), (pixel_x, pixel_y) = (pair[..., None].unbind(1) for pair in (places - center, center))
    right, down = steps.unbind(1)
    x = near_x + warp[:, 0, 0, None] * right + warp[:, 0, 1, None] * down
    y = near_y + warp[:, 1, 0, None] * right + warp[:, 1, 1, None] * down
    # A deformed square lies in the image if its corners do; False where a position is NaN.
    side = math.isqrt(len(steps))
    whole = torch.ones_like(pixel_x, dtype=torch.bool)
    for at, pixel, size in ((x, pixel_x, width), (y, pixel_y, height)):
        edge = at.unflatten(1, (side, side))[:, :: side - 1, :: side - 1].flatten(1) + pixel
        whole = whole & ((edge >= 1) & (edge <= size - 2)).all(1, keepdim=True)
    first_x, weights_x = _taps(x, pixel_x, whole, width)
    first_y, weights_y = _taps(y, pixel_y, whole, height)
    # torch cannot index uint16.
    flat = (images.to(places.dtype) if images.dtype == torch.uint16 else images).reshape(-1)
    index = (number[:, None] * height + first_y) * width + first_x
    if torch.compiler.is_exporting():
        # Gather all sixteen pixels of a sample at once: separately they are a hundred small operations.
        taps = torch.arange(4, dtype=torch.int32, device=index.device)
        pixels = taken(flat, index.to(torch.int32) + (taps[:, None] * width + taps)[..., None, None])
        samples = ((pixels.to(places.dtype) * torch.stack(weights_x)).sum(1) * torch.stack(weights_y)).sum(0)
    else:
        samples = torch.zeros_like(x)
        for lower, weight in enumerate(weights_y):
            line = [taken(flat, index, lower * width + right).to(places.dtype) for right in range(4)]
            samples = torch.addcmul(samples, weight, add_all([a * b for a, b in zip(line, weights_x, strict=True)]))
    return torch.where(whole, samples, torch.nan)


def _taps(at: Tensor, pixel: Tensor, whole: Tensor, size: int) -> tuple[Tensor, list[Tensor]]:
    """Return the first of the four pixels (N, m) from which each sample is interpolated along one axis, and the four
    weights of cubic convolution.

    `at` (N, m) are positions relative to `pixel` (N, 1). The result is arbitrary where a window is not `whole` (N, 1).
    """
    at = torch.where(whole, at, 0.0)
    first = at.floor()
    pixel = torch.where(whole, pixel, 1.0)
    first = torch.minimum(first, size - 3 - pixel)  # at the last position the fraction is 1 instead of 0
    t = at - first
    weights = [_far(1 + t), _near(t), _near(1 - t), _far(2 - t)]
    return (first + (pixel - 1)).to(torch.int64), weights


def _near(distance: Tensor) -> Tensor:
    """Return the cubic convolution weight of a pixel at most 1 px from a sample (Keys 1981, equation 15)."""
    return ((_SHARPNESS + 2) * distance - (_SHARPNESS + 3)) * distance * distance + 1


def _far(distance: Tensor) -> Tensor:
    """Return the cubic convolution weight of a pixel 1 to 2 px from a sample (Keys 1981)."""
    return _SHARPNESS * (((distance - 5) * distance + 8) * distance - 4)


def _steps(window: int, step: int, like: Tensor) -> Tensor:
    """Return the sampling grid (m, 2) px of a window, relative to the window's centre, in steps of `step` px."""
    reach = window // 2
    offsets = torch.arange(-reach, reach + 1, step, dtype=like.dtype, device=like.device)
    y, x = torch.meshgrid(offsets, offsets, indexing="ij")
    return torch.stack((x.flatten(), y.flatten()), -1)
