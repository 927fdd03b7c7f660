"""The linear system of dense flow, (J + alpha L) d = r, by multigrid: two numbers a pixel, coupled by 2 x 2 tensors.

L is the graph Laplacian of the pixels of a mask, so that its border is natural: nothing flows across it. Coarser levels
stand for 2 x 2 cells each: J and r are means over them, and an edge between two cells has a fourth of the mean weight
of the two that cross it, which is what the fine operator does to a field that is constant on cells and differs from one
to the next as a plane does (Bruhn, Weickert, Schnoerr, IEEE Trans. Image Processing 14(5), 2005, restrict the tensors
too). Smoothing is damped 2 x 2 block Jacobi: the same numbers in any order of pixels.

Every step is a stencil of fixed cost. One V-cycle leaves 1 to 10 % of the residual on skin.
"""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from fingerflow import kernels

DAMPING = 0.8  # of a Jacobi step
SWEEPS = 2  # before and after the coarser levels
COARSEST_SWEEPS = 20
_REGULAR = 1e-6
SMALLEST_SIDE = 4  # px: a level with a side of so few or fewer is the last


class Level(NamedTuple):
    """Operator on (B, ., h, w) cells."""

    tensor: Tensor  # (B, 3, h, w), xx, xy, yy of J, 0 outside the mask
    right: Tensor  # (B, 1, h, w - 1), weight of the edge to the next cell of the row, alpha included
    down: Tensor  # (B, 1, h - 1, w)
    inverse: Tensor  # (B, 3, h, w), of J + alpha deg; 0 where nothing is known
    inside: Tensor  # (B, 1, h, w), 1 where a cell holds a pixel of the mask, else 0


def pyramid(tensor: Tensor, mask: Tensor, alpha: Tensor) -> list[Level]:
    """All levels, the finest first.

    Args:
        tensor: (B, 3, H, W) J, 0 outside the mask.
        mask: (B, 1, H, W), 1 or 0.
        alpha: (B,) weight of the squared differences between neighbours.
    """
    weight = alpha[:, None, None, None]
    right = weight * mask[..., 1:] * mask[..., :-1]
    down = weight * mask[..., 1:, :] * mask[..., :-1, :]
    levels = [_level(tensor, right, down, mask)]
    while min(tensor.shape[-2:]) > SMALLEST_SIDE:
        # Edges between cells: those that cross from their second column (row) to the next cell's first.
        right = _halved(_even(right[..., 1::2], 2), (2, 1)) / 4
        down = _halved(_even(down[..., 1::2, :], 3), (1, 2)) / 4
        tensor, mask = halved(tensor), (halved(mask) > 0).to(mask.dtype)
        levels.append(_level(tensor, right, down, mask))
    return levels


def solve(levels: list[Level], right_side: Tensor, cycles: int) -> Tensor:
    """The solution (B, 2, H, W) after so many V-cycles from 0."""
    if right_side.dtype == torch.float32 and kernels.serve(right_side, *levels[0]):
        return kernels.flow_cycles(
            [plane for level in levels for plane in level], right_side, cycles, SWEEPS, COARSEST_SWEEPS, DAMPING
        )
    solution = _v_cycle(levels, right_side)
    for _ in range(cycles - 1):
        solution = solution + _v_cycle(levels, right_side - applied(levels[0], solution))
    return solution


def applied(level: Level, field: Tensor) -> Tensor:
    """(J + alpha L) of a field (B, 2, h, w)."""
    return _times(level.tensor, field) + laplacian(level, field)


def laplacian(level: Level, field: Tensor) -> Tensor:
    """alpha L of a field (B, C, h, w)."""
    across = level.right * (field[..., 1:] - field[..., :-1])
    along = level.down * (field[..., 1:, :] - field[..., :-1, :])
    pad = functional.pad
    return pad(across, (1, 0)) - pad(across, (0, 1)) + pad(along, (0, 0, 1, 0)) - pad(along, (0, 0, 0, 1))


def halved(cells: Tensor) -> Tensor:
    """(B, C, ceil(h / 2), ceil(w / 2)): means of 2 x 2, what lies beyond the border counting as 0."""
    return _halved(_even(_even(cells, 2), 3), (2, 2))


def magnified(cells: Tensor, times: int) -> Tensor:
    """Bilinear between the middles of cells, on so many times as many places each way, the border repeated."""
    return functional.interpolate(cells, scale_factor=times, mode="bilinear", align_corners=False)


def _level(tensor: Tensor, right: Tensor, down: Tensor, mask: Tensor) -> Level:
    pad = functional.pad
    edges = pad(right, (1, 0)) + pad(right, (0, 1)) + pad(down, (0, 0, 1, 0)) + pad(down, (0, 0, 0, 1))
    xx, xy, yy = tensor[:, :1] + edges, tensor[:, 1:2], tensor[:, 2:] + edges
    determinant = xx * yy - xy * xy
    known = determinant > _REGULAR * (xx + yy).square()  # not a single cell with a slope in one direction
    inverse = torch.cat((yy, -xy, xx), dim=1) / torch.where(known, determinant, 1.0)
    return Level(tensor, right, down, torch.where(known, inverse, 0.0), mask)


def _v_cycle(levels: list[Level], right_side: Tensor) -> Tensor:
    level, coarser = levels[0], levels[1:]
    solution = DAMPING * _times(level.inverse, right_side)
    if not coarser:
        return _relaxed(level, solution, right_side, COARSEST_SWEEPS)
    solution = _relaxed(level, solution, right_side, SWEEPS - 1)
    correction = _v_cycle(coarser, halved(right_side - applied(level, solution)))
    solution = solution + _spread(correction, coarser[0].inside, level.inside)
    return _relaxed(level, solution, right_side, SWEEPS)


def _relaxed(level: Level, solution: Tensor, right_side: Tensor, sweeps: int) -> Tensor:
    for _ in range(sweeps):
        solution = solution + DAMPING * _times(level.inverse, right_side - applied(level, solution))
    return solution


def _spread(coarse: Tensor, known: Tensor, inside: Tensor) -> Tensor:
    """Bilinear between the cells that are known, on the finer level: 9/16, 3/16, 3/16 and 1/16 of the four nearest."""
    height, width = inside.shape[-2:]
    both = magnified(torch.cat((coarse * known, known), dim=1), 2)[..., :height, :width]
    share = both[:, 2:]
    return inside * both[:, :2] / torch.where(share > 0, share, 1.0)


def _even(cells: Tensor, dim: int) -> Tensor:
    """With a last row or column of 0 where their number is odd."""
    if cells.shape[dim] % 2 == 0:
        return cells
    return functional.pad(cells, (0, 0, 0, 1) if dim == 2 else (0, 1))


def _halved(cells: Tensor, sides: tuple[int, int]) -> Tensor:
    return functional.avg_pool2d(cells, sides)


def _times(tensor: Tensor, field: Tensor) -> Tensor:
    """Products (B, 2, h, w) of symmetric 2 x 2 matrices (B, 3, h, w) with vectors."""
    u, v = field[:, :1], field[:, 1:]
    return torch.cat((tensor[:, :1] * u + tensor[:, 1:2] * v, tensor[:, 1:2] * u + tensor[:, 2:] * v), dim=1)
