"""Tests of scattered points to grid nodes: smooth fields are reproduced, and nodes outside the cloud are NaN."""

import math

import torch
from torch import Tensor

from fingerflow.ops.fields.gridding import scattered_to_grid

GAUGE = 1.5


def disc_cloud(count: int = 700, radius: float = 5.0) -> Tensor:
    """Return points (1, count, 2) spread evenly over a disc (a sunflower pattern), with a small jitter."""
    index = torch.arange(count, dtype=torch.float64) + 0.5
    distance, angle = radius * (index / count).sqrt(), index * math.pi * (3 - 5**0.5)
    points = torch.stack((distance * angle.cos(), distance * angle.sin()), dim=-1)[None]
    jitter = torch.randn(points.shape, generator=torch.Generator().manual_seed(14), dtype=torch.float64)
    return points + 0.03 * jitter


def axes() -> tuple[Tensor, Tensor]:
    return torch.linspace(-6, 6, 37, dtype=torch.float64), torch.linspace(-7, 7, 43, dtype=torch.float64)


def test_a_linear_field_is_exact_and_rows_are_y() -> None:
    points = disc_cloud()
    grid_x, grid_y = axes()
    values = torch.stack((2 * points[..., 0] + 1, points[..., 1]), dim=-1)
    field = scattered_to_grid(points, values, grid_x, grid_y, GAUGE)
    assert field.shape == (1, 2, 43, 37)
    rows, columns = torch.meshgrid(grid_y, grid_x, indexing="ij")
    known = field[0, 0].isfinite()
    assert torch.equal(known, field[0, 1].isfinite())
    torch.testing.assert_close(field[0, 0][known], 2 * columns[known] + 1, atol=1e-11, rtol=0)
    torch.testing.assert_close(field[0, 1][known], rows[known], atol=1e-11, rtol=0)


def test_nodes_inside_are_filled_and_nodes_outside_are_nan() -> None:
    points = disc_cloud()
    grid_x, grid_y = axes()
    rows, columns = torch.meshgrid(grid_y, grid_x, indexing="ij")
    distance = torch.hypot(columns, rows)
    known = scattered_to_grid(points, points, grid_x, grid_y, GAUGE)[0, 0].isfinite()
    assert known[distance < 5 - 0.2 * GAUGE].all()
    assert not known[distance > 5 + 0.1 * GAUGE].any()


def test_the_mask_leaves_nothing_outside() -> None:
    points = disc_cloud().expand(2, -1, -1)
    grid = torch.linspace(-2, 2, 5, dtype=torch.float64)
    mask = torch.zeros(2, 1, 5, 5, dtype=torch.bool)
    mask[0, 0, 1:3, 2] = True
    field = scattered_to_grid(points, points, grid, grid, GAUGE, mask)
    assert torch.equal(field.isfinite(), mask.expand(2, 2, 5, 5))
    assert torch.equal(scattered_to_grid(points, points, grid, grid, GAUGE, mask[:1])[1].isfinite()[:1], mask[0])
