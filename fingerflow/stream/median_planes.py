"""The median network on planes of rows: only whole lines move, which an unfused runtime copies in one piece."""

import functools

import torch
from torch import Tensor
from torch.nn import functional

from fingerflow.ops.box_sum import box_sum
from fingerflow.ops.median_network import MedianProgram, tile_program


def median_of_rows(frames: Tensor, size: int) -> Tensor:
    """Median of `size` x `size` windows, (B, 1, H, W) of any type that has a minimum; the nearest pixel beyond the
    border. As `ops.median_filter`, in operations that every runtime of ONNX has for the type that is given."""
    if size == 1:
        return frames
    program = _program(size)
    batch, _, height, width = frames.shape
    rows, half = program.tile[0], size // 2
    down, right = program.reach
    tiles = -(-height // rows)
    grid_y, grid_x = tiles + down, width + right
    padded = _repeat_border(frames[:, 0], half, grid_y * rows - height - half, right - half)
    cells = batch * grid_y * grid_x
    planes = {phase: padded[:, phase::rows].reshape(-1) for phase in range(rows)}
    lengths = dict.fromkeys(planes, cells)
    for operation, result, first, second, shift_y, shift_x, released in program.steps:
        offset = shift_y * grid_x + shift_x
        length = min(lengths[first], lengths[second] - offset)
        one, other = planes[first], planes[second]
        one = one if length == lengths[first] else one[:length]
        other = other if length == lengths[second] else other[offset : offset + length]
        planes[result] = torch.minimum(one, other) if operation == "minimum" else torch.maximum(one, other)
        lengths[result] = length
        for plane in released:
            del planes[plane]
    medians = []
    for plane, shift_y, shift_x in program.outputs:
        offset = shift_y * grid_x + shift_x
        flat = planes[plane][offset:]
        flat = functional.pad(flat, (0, cells - lengths[plane] + offset))
        medians.append(flat.reshape(batch, grid_y, grid_x)[:, :tiles, :width])
    woven = torch.stack(medians, dim=2).reshape(batch, 1, tiles * rows, width)
    return woven[:, :, :height]


def majority(above: Tensor, size: int, precision: torch.dtype) -> Tensor:
    """Where more than half of a `size` x `size` window (B, 1, H, W) holds, of uint8, 0 and 1, or of the precision.

    The median of zeros and ones. The network of 3 x 3 takes 17 operations a pixel on bytes; from 5 x 5 on, sums are
    faster: at most 4 log2(size) of them, on floats, as no runtime adds bytes.
    """
    if size <= 3:
        return median_of_rows(above, size).to(torch.uint8)
    half = size // 2
    padded = _repeat_border(above[:, 0].to(precision), half, half, half)
    return (box_sum(padded, size) > size * size / 2).to(torch.uint8)[:, None]


def _repeat_border(lines: Tensor, before: int, below: int, right: int) -> Tensor:
    """Frames (B, H, W) with their border repeated: `before` times above and to the left."""
    # By concatenation: an expanded line is written number by number.
    lines = torch.cat((*[lines[:, :1]] * before, lines, *[lines[:, -1:]] * below), dim=1)
    return torch.cat((*[lines[..., :1]] * before, lines, *[lines[..., -1:]] * right), dim=2)


@functools.cache
def _program(size: int) -> MedianProgram:
    orders = ["y", "yy"] if size > 4 else ["y"]
    return min((tile_program(size, order) for order in orders), key=lambda program: program.operations_per_pixel)
