"""Multigrid solver of the linear system of dense flow, with the two flow components of each cell as unknowns.

The system is (J + alpha L) d = r. The unknowns of a cell are coupled by a 2 x 2 tensor J. L is the graph Laplacian of
the cells of a mask, which makes the border condition natural: no flux across it. Coarser levels represent 2 x 2 cells
each: J and r are means over them. An edge between two coarse cells has a fourth of the mean weight of the two fine
edges across their common side. This equals the action of the fine operator on a field that is constant on coarse cells
and differs between them as a plane does (Bruhn, Weickert, Schnoerr, IEEE Trans. Image Processing 14(5), 2005, restrict
the tensors too). The smoother is damped 2 x 2 block Jacobi, whose result does not depend on the order of cells.

Every step is a stencil of fixed cost. One V-cycle leaves 1 to 10 % of the residual on skin.

At the fixed point the pull of the images balances the smoothing of the departure from the trend: pull = J (w - w_0) +
alpha L (w - M w), with w_0 the flow at which the pull was computed. L (1 - M) couples cells over the whole window of
the trend, which multigrid cannot invert. A multigrid cycle with J + alpha L therefore reduces the residual of the full
equation, and the trend is recomputed before each cycle. Where ridges run in one direction, one warp and three cycles
bring nine tenths of the flow to within 0.0023 px of the fixed point, one cycle to 0.013.

Compiled twin, of `descended`: `kernels/flow_multigrid.cpp`.
"""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from fingerflow.kernels import tensors as kernels
from fingerflow.ops.flow.flow_cells import COURSE_WINDOW, halved, spread, trend

DAMPING = 0.8  # damping factor of a Jacobi step
SWEEPS = 2  # Jacobi steps before and after the visit to the coarser levels
COARSEST_SWEEPS = 20
_REGULAR = 1e-6
SMALLEST_SIDE = 4  # cells: the first level with a side of this or fewer is the coarsest


class Level(NamedTuple):
    """One multigrid level: the operator J + alpha L on cells, with structure tensor J and graph Laplacian L."""

    tensor: Tensor  # (B, 3, h, w), xx, xy, yy of J, 0 outside the mask
    right: Tensor  # (B, 1, h, w - 1), weights of the edges to the next cell of the row, alpha included
    down: Tensor  # (B, 1, h - 1, w), weights of the edges to the next cell of the column, alpha included
    inverse: Tensor  # (B, 3, h, w), inverse of J + alpha degree; 0 where it is singular
    inside: Tensor  # (B, 1, h, w), 1 where a cell holds a pixel of the mask, else 0


def pyramid(tensor: Tensor, right: Tensor, down: Tensor, mask: Tensor) -> list[Level]:
    """Build the multigrid levels of the linear system of dense flow, J + alpha L with structure tensor J and graph
    Laplacian L: the given finest level first, each further one on cells twice as large.

    Args:
        tensor: (B, 3, H, W) J, 0 outside the mask.
        right, down: (B, 1, H, W - 1) and (B, 1, H - 1, W), weights of the squared differences between neighbours.
        mask: (B, 1, H, W), 1 or 0.
    """
    levels = [_level(tensor, right, down, mask)]
    while min(tensor.shape[-2:]) > SMALLEST_SIDE:
        right, down = halved_edges(right, down)
        tensor, mask = halved(tensor), (halved(mask) > 0).to(mask.dtype)
        levels.append(_level(tensor, right, down, mask))
    return levels


def edges(mask: Tensor) -> tuple[Tensor, Tensor]:
    """Return the edges between neighbouring pixels: 1 where both lie in the mask, else 0.

    Edges along rows are (B, 1, H, W - 1), along columns (B, 1, H - 1, W).
    """
    return mask[..., 1:] * mask[..., :-1], mask[..., 1:, :] * mask[..., :-1, :]


def halved_edges(right: Tensor, down: Tensor) -> tuple[Tensor, Tensor]:
    """Return edge weights between blocks of 2 x 2 cells: a fourth of the mean of the two edges that connect them."""
    right, down = (
        functional.pad(right[..., 1::2], (0, 0, 0, right.shape[-2] % 2)),
        functional.pad(down[..., 1::2, :], (0, down.shape[-1] % 2)),
    )
    return functional.avg_pool2d(right, (2, 1)) / 4, functional.avg_pool2d(down, (1, 2)) / 4


def degrees(right: Tensor, down: Tensor) -> Tensor:
    """Return the degree (B, 1, h, w) of each cell: the sum of the weights of the edges at the cell."""
    pad = functional.pad
    return pad(right, (1, 0)) + pad(right, (0, 1)) + pad(down, (0, 0, 1, 0)) + pad(down, (0, 0, 0, 1))


def descended(levels: list[Level], pull: Tensor, flow: Tensor, known: Tensor, cycles: int) -> Tensor:
    """Improve a flow (B, 2, h, w) on cells by multigrid V-cycles on the linear system of dense flow, whose data term at
    the given flow is `pull`.

    Args:
        levels: of the multigrid; the finest is that of the flow.
        pull: (B, 2, h, w) of the images at the given flow.
        flow: (B, 2, h, w) px; unknown cells start from the trend.
        known: (B, 1, h, w), 1 or 0: cells that contribute to the trend.
        cycles: at least 1.
    """
    if pull.dtype == torch.float32 and kernels.serve(pull, flow, known, *levels[0]):
        planes = [plane for level in levels for plane in level]
        return kernels.flow_descend(planes, pull, flow, known, COURSE_WINDOW, cycles, SWEEPS, COARSEST_SWEEPS, DAMPING)
    base = trend(flow, known)
    flow = torch.where(known > 0, flow, base)
    step = v_cycle(levels, pull - laplacian(levels[0], flow - base))
    for _ in range(cycles - 1):
        moved = flow + step
        over = laplacian(levels[0], moved - trend(moved, known))
        step = step + v_cycle(levels, pull - times(levels[0].tensor, step) - over)
    return flow + step


def v_cycle(levels: list[Level], right_side: Tensor) -> Tensor:
    """Return an approximate solution d (B, 2, H, W) of the system (J + alpha L) d = `right_side` on the first of
    `levels`, from one multigrid V-cycle that starts at d = 0.

    J is the structure tensor and L the graph Laplacian of the smoothness term.
    """
    level, coarser = levels[0], levels[1:]
    solution = DAMPING * times(level.inverse, right_side)
    if not coarser:
        return _relaxed(level, solution, right_side, COARSEST_SWEEPS)
    solution = _relaxed(level, solution, right_side, SWEEPS - 1)
    correction = v_cycle(coarser, halved(right_side - applied(level, solution)))
    solution = solution + level.inside * spread(correction, coarser[0].inside, *level.inside.shape[-2:])
    return _relaxed(level, solution, right_side, SWEEPS)


def applied(level: Level, field: Tensor) -> Tensor:
    """Multiply a field (B, 2, h, w) by the operator J + alpha L of a level: structure tensor J, graph Laplacian L."""
    return times(level.tensor, field) + laplacian(level, field)


def laplacian(level: Level, field: Tensor) -> Tensor:
    """Multiply a field (B, C, h, w) by the weighted graph Laplacian alpha L (smoothness term) of a level."""
    across = level.right * (field[..., 1:] - field[..., :-1])
    along = level.down * (field[..., 1:, :] - field[..., :-1, :])
    pad = functional.pad
    return pad(across, (1, 0)) - pad(across, (0, 1)) + pad(along, (0, 0, 1, 0)) - pad(along, (0, 0, 0, 1))


def _level(tensor: Tensor, right: Tensor, down: Tensor, mask: Tensor) -> Level:
    degree = degrees(right, down)
    xx, xy, yy = tensor[:, :1] + degree, tensor[:, 1:2], tensor[:, 2:] + degree
    determinant = xx * yy - xy * xy
    regular = determinant > _REGULAR * (xx + yy).square()  # False for an isolated cell with a slope in one direction
    inverse = torch.cat((yy, -xy, xx), dim=1) / torch.where(regular, determinant, 1.0)
    return Level(tensor, right, down, torch.where(regular, inverse, 0.0), mask)


def _relaxed(level: Level, solution: Tensor, right_side: Tensor, sweeps: int) -> Tensor:
    for _ in range(sweeps):
        solution = solution + DAMPING * times(level.inverse, right_side - applied(level, solution))
    return solution


def times(tensor: Tensor, field: Tensor) -> Tensor:
    """Multiply symmetric 2 x 2 matrices (B, 3, h, w), given as xx, xy, yy, by vectors (B, 2, h, w)."""
    u, v = field[:, :1], field[:, 1:]
    return torch.cat((tensor[:, :1] * u + tensor[:, 1:2] * v, tensor[:, 1:2] * u + tensor[:, 2:] * v), dim=1)
