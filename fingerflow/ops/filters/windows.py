"""Square windows around points: cut from the pixel grid, or sampled from the spline at fractional and warped positions.

Points are passed as one flat list of P points from any of the images, each with the index of its image.

No twin of their own: `kernels/templates.cpp` and `kernels/search.cpp` contain their compiled forms.
"""

import torch
import torch.nn.functional as F
from torch import Tensor

from fingerflow.ops.filters.spline import spline_weights
from fingerflow.ops.pieces import points_at_once

_POINTS_AT_A_TIME = 128


def cut_windows(images: Tensor, image_index: Tensor, corner: Tensor, size: int) -> Tensor:
    """Cut one window of ``size`` x ``size`` pixels for each of P points from images (B, 1, H, W), given the first pixel
    (`corner`) of each window.

    Args:
        images: (B, 1, H, W).
        image_index: (P,) int64, the image of each point.
        corner: (P, 2) int64 (x, y) of the first pixel. Beyond the border the nearest pixel counts.
        size: px.

    Returns:
        (P, size, size) as (row, column).
    """
    height, width = images.shape[-2:]
    steps = torch.arange(size, device=images.device)
    row = (corner[:, 1, None] + steps).clamp(0, height - 1)
    if not images.requires_grad and not torch.compiler.is_exporting():
        wide = F.pad(images, (size, size, 0, 0), mode="replicate")
        column = (corner[:, 0, None] + size).clamp(0, width + size)
        return take_lines(wide, (row + image_index[:, None] * height) * wide.shape[3] + column, size)
    # The gradient with respect to the view in `take_lines` would be ``size`` times as large as the image.
    column = (corner[:, 0, None] + steps).clamp(0, width - 1)
    return taken(images.reshape(-1), ((row + image_index[:, None] * height) * width)[:, :, None] + column[:, None, :])


def sample_windows(
    coefficients: Tensor, image_index: Tensor, points: Tensor, size: int, warp: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Evaluate the spline of an image, and the gradient of the spline, at the `size` x `size` samples, 1 px apart, of a
    window around each point; `warp` deforms the windows.

    Args:
        coefficients: (B, 1, H, W) from :func:`~fingerflow.ops.filters.spline.spline_coefficients`.
        image_index: (P,) int64.
        points: (P, 2) (x, y) in px, finite.
        size: odd number of samples per side.
        warp: (P, 2, 2) A; samples lie at ``point + A w`` instead of ``point + w``, w the integer window offsets.

    Returns:
        Values (P, size, size) and gradients with respect to w (P, 2, size, size), as (d/dx, d/dy).
    """
    if warp is not None:
        return _sample_warped(coefficients, image_index, points, size, warp)
    whole = points.detach().floor()
    weights, slopes = (torch.stack(taps, dim=-1) for taps in spline_weights(points - whole))
    patch = cut_windows(coefficients, image_index, whole.long() - size // 2 - 1, size + 3)
    rows = _convolve(patch, weights[:, 1], size, dim=1)
    rows_slope = _convolve(patch, slopes[:, 1], size, dim=1)
    value = _convolve(rows, weights[:, 0], size, dim=2)
    gradient = torch.stack(
        (_convolve(rows, slopes[:, 0], size, dim=2), _convolve(rows_slope, weights[:, 0], size, dim=2)), dim=1
    )
    return value, gradient


def _convolve(patch: Tensor, weights: Tensor, size: int, dim: int) -> Tensor:
    """Filter the patch of each of P points along the axis `dim` with that point's own weights (P, taps); return
    ``size`` samples along the axis.
    """
    taps = weights[:, :, None, None].unbind(1)
    total = taps[0] * patch.narrow(dim, 0, size)
    for k in range(1, len(taps)):
        total = torch.addcmul(total, taps[k], patch.narrow(dim, k, size))
    return total


def _sample_warped(
    coefficients: Tensor, image_index: Tensor, points: Tensor, size: int, warp: Tensor
) -> tuple[Tensor, Tensor]:
    """Evaluate a spline and the spline's gradient on warped windows, with separate spline weights for every sample.

    The positions of the samples of a warped window have no common fraction.
    """
    flat = coefficients.reshape(-1)
    at_once = points_at_once(points, _POINTS_AT_A_TIME)  # few points at a time, so that their weights stay in the cache
    pieces = zip(*(whole.split(at_once) for whole in (image_index, points, warp)), strict=True)
    sampled = [
        _sample_piece(flat, coefficients.shape, indices, positions, warps, size) for indices, positions, warps in pieces
    ]
    values, gradients = zip(*sampled, strict=True)
    return torch.cat(values), torch.cat(gradients)


def _sample_piece(
    flat: Tensor, shape: torch.Size, image_index: Tensor, points: Tensor, warp: Tensor, size: int
) -> tuple[Tensor, Tensor]:
    height, width = shape[-2:]
    half = size // 2
    offset = torch.arange(-half, half + 1, device=points.device, dtype=points.dtype)
    # (P, size, size) positions relative to the pixel nearest to the point, as absolute positions would lose two digits.
    # Windows have rows along y and columns along x.
    center = points.detach().round()[..., None, None]
    (at_x, at_y), (pixel_x, pixel_y) = (points[..., None, None] - center).unbind(1), center.unbind(1)
    x = at_x + warp[:, 0, 0, None, None] * offset + warp[:, 0, 1, None, None] * offset[:, None]
    y = at_y + warp[:, 1, 0, None, None] * offset + warp[:, 1, 1, None, None] * offset[:, None]
    # Clamp to pixels for which all spline taps exist; a window that reaches beyond the frame is discarded anyway.
    whole_x = (x.detach().floor() + pixel_x).clamp(1, width - 3)
    whole_y = (y.detach().floor() + pixel_y).clamp(1, height - 3)
    # Beyond the frame, where a cubic would diverge, the border value is repeated.
    weights_x, slopes_x = spline_weights((x - (whole_x - pixel_x)).clamp(-1, 2))
    weights_y, slopes_y = spline_weights((y - (whole_y - pixel_y)).clamp(-1, 2))
    image = image_index[:, None, None] * height
    index = (whole_y.long() - 1 + image) * width + (whole_x.long() - 1)
    # Subtract the central pixel, so that a constant window has exactly zero gradient in any precision.
    middle = (pixel_y.clamp(0, height - 1).long() + image) * width + pixel_x.clamp(0, width - 1).long()
    level = taken(flat, middle)
    value = along_x = along_y = torch.zeros((), dtype=points.dtype, device=points.device)
    for k in range(4):
        taps = [taken(flat, index, k * width + j) - level for j in range(4)]
        row_value, row_slope = weights_x[0] * taps[0], slopes_x[0] * taps[0]
        for j in range(1, 4):
            row_value = torch.addcmul(row_value, weights_x[j], taps[j])
            row_slope = torch.addcmul(row_slope, slopes_x[j], taps[j])
        value = torch.addcmul(value, weights_y[k], row_value)
        along_x = torch.addcmul(along_x, weights_y[k], row_slope)
        along_y = torch.addcmul(along_y, slopes_y[k], row_value)
    # Chain rule: d/dw = A^T d/dx.
    gradient = torch.stack(
        (
            warp[:, 0, 0, None, None] * along_x + warp[:, 1, 0, None, None] * along_y,
            warp[:, 0, 1, None, None] * along_x + warp[:, 1, 1, None, None] * along_y,
        ),
        dim=1,
    )
    return value + level, gradient


def take_lines(planes: Tensor, first: Tensor, length: int) -> Tensor:
    """Copy runs of ``length`` consecutive pixels from images, starting at the flat pixel indices ``first`` (...).

    Whole lines are copied ten times as fast as single pixels are gathered.
    """
    if not len(first):
        return planes.new_empty(*first.shape, length)
    return planes.flatten().unfold(0, length, 1).index_select(0, first.flatten()).reshape(*first.shape, length)


def taken(flat: Tensor, index: Tensor, later: int = 0) -> Tensor:
    """Return the elements of a flat tensor at the positions ``index`` + ``later``, in the shape of ``index``."""
    if torch.compiler.is_exporting():  # ONNX runtimes gather single elements four times as fast
        return flat.gather(0, index.flatten().to(torch.int32) + later).reshape(index.shape)
    # Offset by a view, which needs no new index; `take` and indexing need four times as long.
    return flat[later:].index_select(0, index.flatten()).reshape(index.shape)
