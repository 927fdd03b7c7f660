"""Charbonnier's penalty of dense flow, by lagged diffusivity.

sqrt(c^2 + z) in place of z for both terms: quadratic where z is small, a length where it is large, so that what stands
still before skin that moves (dust on the glass), or a jump of the motion, costs less than its square (Bruhn, Weickert,
Schnoerr, IJCV 61(3), 2005, section 4). With its derivative, 1 / sqrt(c^2 + z) up to a factor, taken from the latest
flow the system is the quadratic one with weights, which every warp takes anew:

- z of the data is the mean square that is left in a cell over what noise leaves there. It weights the cell inside the
  windows, so that a speck of dust counts for less in all windows that hold it. The paper weights whole windows: with
  that, dust leaves 1.6 to 1.8 times the error.
- z of the smoothing is the squared gradient of the departure from the course, both components together, across each
  edge between two cells.

The factors are such that noise alone has weights of 1 in the mean of the data, and no departure has 1 of the smoothing.
"""

from typing import Literal, get_args

import torch
from torch import Tensor

from fingerflow.kernels.flow import Left
from fingerflow.ops.flow.flow_cells import CELL
from fingerflow.ops.flow.flow_course import course
from fingerflow.ops.flow.flow_multigrid import Level, degrees, pyramid

Penalty = Literal["quadratic", "charbonnier"]

# c of the data, in deviations of what noise leaves. At 1, dust leaves a fifth less, a jump of 1.5 px an eighth more.
_DATA_SCALE = 2.0
# c of the smoothing, in `roughness`. At 0.3, a jump of 1.5 px leaves half as much again; at 0.03, ridges a third more.
_EDGE_SCALE = 0.1
_TINY = 1e-12


def check_penalty(penalty: str) -> None:
    """Raises a ValueError unless it is one of the two."""
    if penalty not in get_args(Penalty):
        raise ValueError(f"penalty must be one of {get_args(Penalty)}, not {penalty!r}")


def data_weights(left: Left[Tensor], by_noise: Tensor) -> Tensor:
    """Weights (B, 1, h, w) of cells of which so much is left; `by_noise` (B,), the mean square that noise leaves."""
    expected = by_noise[:, None, None, None] * (1 + left.gain * left.gain) / 2
    ratio = left.squares / (left.seen.clamp_min(_TINY) * expected)
    return ((_DATA_SCALE**2 + 1) / (_DATA_SCALE**2 + ratio)).sqrt()


def weighted_levels(finest: Level, tensor: Tensor, flow: Tensor, known: Tensor, roughness: float) -> list[Level]:
    """The multigrid of dense flow with the weights of a flow (B, 2, h, w) on cells.

    Args:
        finest: of the quadratic system.
        tensor: (B, 3, h, w) J with the weights of the data.
        flow: (B, 2, h, w) px.
        known: (B, 1, h, w), 1 or 0: what takes part in the course, which the rest follows.
        roughness: as of `dense_flow`.
    """
    departure = torch.where(known > 0, flow - course(flow, known), 0.0)
    right, down = edge_weights(departure, roughness)
    return pyramid(finest.inside * tensor, finest.right * right, finest.down * down, finest.inside)


def edge_weights(departure: Tensor, roughness: float) -> tuple[Tensor, Tensor]:
    """Of the edges to the next cell of the row (B, 1, h, w - 1), and of the column (B, 1, h - 1, w)."""
    scale = (CELL * _EDGE_SCALE * roughness) ** 2

    def weights(difference: Tensor) -> Tensor:
        return (1 + difference.square().sum(1, keepdim=True) / scale).rsqrt()

    return weights(departure[..., 1:] - departure[..., :-1]), weights(departure[..., 1:, :] - departure[..., :-1, :])


def mean_edge_weight(finest: Level, quadratic: Level) -> Tensor:
    """(B, 1, h, w) of the edges that meet in a cell; 1 where none does."""
    whole = degrees(quadratic.right, quadratic.down)
    return torch.where(whole > 0, degrees(finest.right, finest.down) / torch.where(whole > 0, whole, 1.0), 1.0)
