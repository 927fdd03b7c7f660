"""Interpolation of a field from scattered points to the nodes of a regular grid."""

import torch
from torch import Tensor

from fingerflow.ops.fields.local_fit import local_gradients
from fingerflow.ops.fields.scattered import working_dtype

# Largest offset, in gauge lengths, of the points' centroid from a node. For a node on the straight border of a uniform
# cloud it is 0.145.
_MAXIMUM_CENTROID_OFFSET = 0.15


def scattered_to_grid(
    points: Tensor, values: Tensor, grid_x: Tensor, grid_y: Tensor, gauge_length: float, mask: Tensor | None = None
) -> Tensor:
    """Interpolate values (B, N, C) at scattered points (B, N, 2) to the H x W nodes of a regular grid: (B, C, H, W).

    Each node takes the value of the weighted linear fit of `local_gradients` with this gauge length (see there for the
    smoothing). It is exact for linear fields. A node is NaN
    - outside `mask`;
    - where the points around it do not determine a fit;
    - where the points do not surround it: their weighted centroid is more than 0.15 gauge lengths away. On a straight
      border of a uniform cloud the distance is 0.145 gauge lengths; outside it is larger. The scatter of the points
      makes this limit uncertain by about a tenth of the gauge length; sharp corners are cut.

    Args:
        points: (B, N, 2) positions (x, y) in a length unit L.
        values: (B, N, C).
        grid_x, grid_y: (W,) and (H,), coordinates of the nodes in L.
        gauge_length: diameter of the support of a fit, L.
        mask: (1 or B, 1, H, W) bool, such as the apparent contact area; None for everywhere.

    Raises:
        TypeError, ValueError: a dtype, shape or gauge length is invalid.

    Source: that of `local_gradients`, which is compiled.

    Convention:
        axes: the last axis of points is (x, y); rows of the result follow `grid_y`, columns `grid_x`.
        sign: that of the values.
        pixel centre: nodes lie at the coordinates of the axes, in the unit of the points.
        dtype: widest of points and values, at least float32.
        NaN: in a point or its value, leaves the point out; a node without a fit is NaN.
        border: a node that points do not surround is NaN.
    """
    for name, axis in (("grid_x", grid_x), ("grid_y", grid_y)):
        if axis.dim() != 1:
            raise ValueError(f"{name} must have one dimension, found {tuple(axis.shape)}")
    if mask is not None and (mask.dtype != torch.bool or mask.shape[1:] != (1, *grid_y.shape, *grid_x.shape)):
        shape = f"(B, 1, {grid_y.shape[0]}, {grid_x.shape[0]})"
        raise ValueError(f"mask must be bool {shape}, found {mask.dtype} {tuple(mask.shape)}")
    rows, columns = torch.meshgrid(grid_y, grid_x, indexing="ij")
    nodes = torch.stack((columns, rows), dim=-1).flatten(0, 1)[None].to(working_dtype(points, values))
    fit = local_gradients(points, values, nodes, gauge_length=gauge_length)
    surrounded = fit.centroid_offset <= _MAXIMUM_CENTROID_OFFSET * gauge_length
    field = torch.where(surrounded[..., None], fit.value, torch.nan)
    field = field.transpose(1, 2).unflatten(2, rows.shape)
    return field if mask is None else torch.where(mask, field, torch.nan)
