"""The median network on planes of rows: only whole lines move, which an unfused runtime copies in one piece."""

import functools

import torch
from torch import Tensor
from torch.nn import functional

from fingerflow.ops.median import run_network
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
    phases = [padded[:, phase::rows].reshape(-1) for phase in range(rows)]
    medians = [
        plane.reshape(batch, grid_y, grid_x)[:, :tiles, :width]
        for plane in run_network(program.steps, program.outputs, phases, grid_x, views=False)
    ]
    woven = torch.stack(medians, dim=2).reshape(batch, 1, tiles * rows, width)
    return woven[:, :, :height]


def majority(above: Tensor, size: int) -> Tensor:
    """Where more than half of a `size` x `size` window (B, 1, H, W) of zeros and ones of any type holds, uint8.

    The median of zeros and ones, by their mean: of floats, as no runtime adds bytes.
    """
    half = size // 2
    padded = _repeat_border(above[:, 0], half, half, half)[:, None]
    return (functional.avg_pool2d(padded.to(torch.float32), size, 1) > 0.5).to(torch.uint8)


def _repeat_border(lines: Tensor, before: int, below: int, right: int) -> Tensor:
    """Frames (B, H, W) with their border repeated: `before` times above and to the left."""
    # By concatenation: an expanded line is written number by number.
    lines = torch.cat((*[lines[:, :1]] * before, lines, *[lines[:, -1:]] * below), dim=1)
    return torch.cat((*[lines[..., :1]] * before, lines, *[lines[..., -1:]] * right), dim=2)


@functools.cache
def _program(size: int) -> MedianProgram:
    orders = ["y", "yy"] if size > 4 else ["y"]
    return min((tile_program(size, order) for order in orders), key=lambda program: program.operations_per_pixel)
