"""A field known at scattered points, on the nodes of a regular grid."""

import torch
from torch import Tensor

from fingerflow.ops.fields.local_fit import local_gradients
from fingerflow.ops.fields.scattered import working_dtype

# Of the gauge length. A node on the straight border of a uniform cloud has its weighted centroid at 0.145.
_MAXIMUM_CENTROID_OFFSET = 0.15


def scattered_to_grid(
    points: Tensor,
    values: Tensor,
    grid_x: Tensor,
    grid_y: Tensor,
    gauge_length: float,
    mask: Tensor | None = None,
) -> Tensor:
    """Values (B, N, C) at points (B, N, 2) to (B, C, H, W) on the nodes grid_x (W,), grid_y (H,), in one length unit.

    Each node takes the height of the weighted linear fit of `local_gradients` with this gauge length (which see for the
    smoothing): exact for linear fields. A node is NaN
        outside `mask`, (B, 1, H, W) bool with a batch that may be 1, such as the gross contact area;
        where the points around it do not determine a fit;
        where they do not surround it: their weighted centroid is over 0.15 gauge lengths away, as it is on a straight
            border of a uniform cloud and outside. The scatter of the points makes that limit uncertain by about a tenth
            of the gauge length; sharp corners are cut.

    Raises TypeError or ValueError for a wrong dtype, shape or gauge length.
    """
    for name, axis in (("grid_x", grid_x), ("grid_y", grid_y)):
        if axis.dim() != 1:
            raise ValueError(f"{name} must have one dimension, found {tuple(axis.shape)}")
    if mask is not None and (mask.dtype != torch.bool or mask.shape[1:] != (1, *grid_y.shape, *grid_x.shape)):
        wanted = f"(B, 1, {grid_y.shape[0]}, {grid_x.shape[0]})"
        raise ValueError(f"mask must be bool {wanted}, found {mask.dtype} {tuple(mask.shape)}")
    rows, columns = torch.meshgrid(grid_y, grid_x, indexing="ij")
    nodes = torch.stack((columns, rows), dim=-1).flatten(0, 1)[None].to(working_dtype(points, values))
    fit = local_gradients(points, values, nodes, gauge_length=gauge_length)
    surrounded = fit.centroid_offset <= _MAXIMUM_CENTROID_OFFSET * gauge_length
    field = torch.where(surrounded[..., None], fit.value, torch.nan)
    field = field.transpose(1, 2).unflatten(2, rows.shape)
    return field if mask is None else torch.where(mask, field, torch.nan)
