"""Median filter evaluated at every n-th pixel only, for the estimation of thresholds."""

from typing import Any

import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.median_network import join_program
from fingerflow.ops.filters.median import median_filter, plain, run_network

# Least step, px, from which windows are computed independently; each then takes up to 7 times the operations of a
# window that shares them with its neighbours.
_OWN_WINDOWS = 3


def strided_median(frames: Tensor, size: int, step: int) -> Tensor:
    """Compute the median filter at every `step`-th pixel of every `step`-th line.

    The result is `median_filter(frames, size)[..., ::step, ::step]`. The columns of all windows are sorted in one
    batch. Then one half of each window's columns is merged with the other half, again in one batch, until one column is
    left.

    Args:
        frames: (B, 1, H, W) of any dtype with a minimum. Beyond the border the nearest pixel counts.
        size: window side in pixels, odd.
        step: px.

    Returns:
        (B, 1, ceil(H / step), ceil(W / step)).
    """
    height, width = frames.shape[-2:]
    if size == 1 or step < _OWN_WINDOWS:
        return median_filter(frames, size)[..., ::step, ::step]
    rows, columns = (_window_places(side, size, step, frames.device) for side in (height, width))
    # Transpose columns to lines, so that each is gathered as one contiguous piece.
    lines = frames[:, 0].index_select(1, rows.flatten()).unflatten(1, rows.shape).transpose(2, 3)
    # Shape (B, size, size, w, h): row and column in the window, then column and row of the window.
    windows = lines.index_select(2, columns.flatten()).unflatten(2, columns.shape)
    (median,) = _merge_columns(_sort(list(windows.unbind(1)), size), size, size)
    return median.transpose(2, 3)


def _window_places(side: int, size: int, step: int, device: torch.device) -> Tensor:
    """Return the pixel indices (size, windows) along one axis of windows `step` px apart, clamped to the frame."""
    middle = torch.arange(0, side, step, device=device)
    return (torch.arange(size, device=device)[:, None] - size // 2 + middle).clamp(0, side - 1)


def _sort(pixels: list[Tensor], size: int) -> list[Tensor]:
    if len(pixels) == 1:
        return pixels
    half = 1 << (len(pixels) - 1).bit_length() - 1  # largest power of two below the number of pixels
    first, second = _sort(pixels[:half], size), _sort(pixels[half:], size)
    return _join(first, half, second, len(pixels) - half, size)


def _merge_columns(columns: list[Tensor], count: int, size: int) -> list[Tensor]:
    """Merge the sorted columns of each window (along axis 1, `count` pixels each) into one sorted column."""
    width = columns[0].shape[1]
    if width == 1:
        return columns
    half = width // 2
    parts = [plane.split([half, half, width - 2 * half][: 2 + width % 2], dim=1) for plane in columns]
    merged = _join([part[0] for part in parts], count, [part[1] for part in parts], count, size)
    merged = _merge_columns(merged, 2 * count, size)
    if width % 2:
        merged = _join(merged, (width - 1) * count, [part[2] for part in parts], count, size)
    return merged


def _join(first: list[Tensor], first_count: int, second: list[Tensor], second_count: int, size: int) -> list[Tensor]:
    compiling = torch.compiler.is_compiling() and not torch.compiler.is_exporting()
    steps, outputs = (_planned if compiling else join_program)(size, first_count, second_count)
    return run_network(steps, outputs, [*first, *second])


@kernels.constant_to_compiler
def _planned(size: int, first: int, second: int) -> Any:
    return plain(join_program(size, first, second))
