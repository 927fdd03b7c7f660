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
    below = grid_y * rows - height - half
    padded = functional.pad(frames, (half, right - half, half, below), mode="replicate")[:, 0]
    phases = [padded[:, phase::rows].reshape(-1) for phase in range(rows)]
    medians = [
        plane.reshape(batch, grid_y, grid_x)[:, :tiles, :width]
        for plane in run_network(program.steps, program.outputs, phases, grid_x, views=False)
    ]
    woven = torch.stack(medians, dim=2).reshape(batch, 1, tiles * rows, width)
    return woven[:, :, :height]


def majority(above: Tensor, size: int, step: int = 1) -> Tensor:
    """Where more than half of a `size` x `size` window of zeros and ones (B, 1, H, W) holds, uint8; of every `step`-th
    window of every `step`-th line.

    The median of zeros and ones, by their mean: of floats, as no runtime adds bytes.
    """
    if size == 1:
        return above[..., ::step, ::step].to(torch.uint8)
    half = size // 2
    padded = functional.pad(above, (half, half, half, half), mode="replicate")
    return (functional.avg_pool2d(padded.to(torch.float32), size, step) > 0.5).to(torch.uint8)


@functools.cache
def _program(size: int) -> MedianProgram:
    orders = ["y", "yy"] if size > 4 else ["y"]
    return min((tile_program(size, order) for order in orders), key=lambda program: program.operations_per_pixel)
