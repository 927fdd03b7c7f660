"""Charbonnier's robust penalty for dense flow, as a quadratic penalty with weights (lagged diffusivity).

Both terms have sqrt(c^2 + z) in place of z: quadratic for small differences, linear for large ones. What stands still
before moving skin (dust on the glass), or a jump of the motion, then costs less than its square (Bruhn, Weickert,
Schnoerr, IJCV 61(3), 2005, section 4). The derivative, 1 / sqrt(c^2 + z) up to a factor, is evaluated at the latest
flow. The system is then the quadratic one with weights, which are updated at every warp:

- z of the data is the mean squared residual in a cell, relative to that of noise. It weights the cell inside the
  windows, so that a speck of dust counts less in all windows that contain it. The paper weights whole windows: with
  that, dust leaves 1.6 to 1.8 times the error.
- z of the smoothing is the squared gradient of the departure from the trend, of both components together, across each
  edge between two cells.

Factors are chosen so that the data weight is 1 for a mean squared residual equal to that of noise, and the smoothing
weight is 1 for zero departure.

No compiled twin.
"""

from typing import Literal

import torch
from torch import Tensor

from fingerflow.ops.flow.flow_cells import CELL, trend
from fingerflow.ops.flow.flow_multigrid import Level, degrees, pyramid

Penalty = Literal["quadratic", "charbonnier"]
FlowModel = Literal["auto", "quadratic", "charbonnier", "edges"]

# Scale c of the penalty on the data, in standard deviations that noise leaves in the residual. With 1 the error is a
# fifth smaller at dust and an eighth larger at a jump of 1.5 px.
_DATA_SCALE = 2.0
# Scale c of the penalty on the smoothing, in units of `roughness`. With 0.3 the error is half as large again at a jump
# of 1.5 px; with 0.03 it is a third larger on ridges.
_EDGE_SCALE = 0.1
_TINY = 1e-12


# Residual of a flow: means, over cells of 2 x 2 px, of the part of the image difference that displacement and
# illumination do not explain: of its products with the slopes (B, 2, h, w), of its squares (B, 1, h, w) and of the
# share of the pixels with a residual (B, 1, h, w); and the illumination gain (B, 1, 1, 1).
FlowResidual = tuple[Tensor, Tensor, Tensor, Tensor]


def data_weights(left: FlowResidual, by_noise: Tensor) -> Tensor:
    """Return the weights (B, 1, h, w) of cells in the data term of dense flow: 1 where the residual of the latest flow
    (`left`) has the mean square that noise causes, lower where it is larger.

    `by_noise` (B,) is the mean square that noise leaves.
    """
    _, squares, seen, gain = left
    expected = by_noise[:, None, None, None] * (1 + gain * gain) / 2
    ratio = squares / (seen.clamp_min(_TINY) * expected)
    return ((_DATA_SCALE**2 + 1) / (_DATA_SCALE**2 + ratio)).sqrt()


def weighted_levels(finest: Level, tensor: Tensor, flow: Tensor, valid: Tensor, roughness: float) -> list[Level]:
    """Build the multigrid levels of dense flow for the robust penalty: an edge between cells has a low smoothness
    weight where the given flow (B, 2, h, w), minus its smooth trend, jumps.

    Args:
        finest: level of the quadratic system.
        tensor: (B, 3, h, w) J with the weights of the data.
        flow: (B, 2, h, w) px.
        valid: (B, 1, h, w), 1 or 0: cells that contribute to the trend; at the others the departure is 0.
        roughness: as of `dense_flow`.
    """
    departure = torch.where(valid > 0, flow - trend(flow, valid), 0.0)
    scale = (CELL * _EDGE_SCALE * roughness) ** 2

    def weights(difference: Tensor) -> Tensor:
        return (1 + difference.square().sum(1, keepdim=True) / scale).rsqrt()

    right = finest.right * weights(departure[..., 1:] - departure[..., :-1])
    down = finest.down * weights(departure[..., 1:, :] - departure[..., :-1, :])
    return pyramid(finest.inside * tensor, right, down, finest.inside)


def mean_edge_weight(finest: Level, quadratic: Level) -> Tensor:
    """Return, for each cell, the mean (B, 1, h, w) of the smoothness weights that the robust penalty gives its edges in
    `finest`, relative to the level of the `quadratic` penalty; 1 for a cell without edges.
    """
    whole = degrees(quadratic.right, quadratic.down)
    return torch.where(whole > 0, degrees(finest.right, finest.down) / torch.where(whole > 0, whole, 1.0), 1.0)
