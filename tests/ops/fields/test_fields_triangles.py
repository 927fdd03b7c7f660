"""Tests of gradients, areas and quality of triangles against known linear fields."""

import pytest
import torch
from torch import Tensor

from fingerflow.ops.fields.triangles import triangle_areas, triangle_gradients, triangle_quality

UNIT_TRIANGLE = torch.tensor([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]], dtype=torch.float64)


def lattice(side: int = 6) -> tuple[Tensor, Tensor]:
    """Return a jittered lattice (1, side^2, 2) of unit spacing and its 2 (side - 1)^2 triangles, none of them flat."""
    generator = torch.Generator().manual_seed(1)
    rows, columns = torch.meshgrid(torch.arange(side), torch.arange(side), indexing="ij")
    points = torch.stack((columns, rows), dim=-1).reshape(1, -1, 2).double()
    points = points + 0.3 * (torch.rand(points.shape, generator=generator, dtype=torch.float64) - 0.5)
    corner = (side * rows[:-1, :-1] + columns[:-1, :-1]).reshape(-1, 1)
    lower = corner + torch.tensor([0, 1, side])
    return points, torch.cat((lower, corner + torch.tensor([1, side + 1, side])))


def test_a_linear_field_is_exact() -> None:
    points, triangles = lattice()
    gradient = torch.tensor([[0.02, -0.01], [0.03, 0.01]], dtype=torch.float64)
    found = triangle_gradients(points, triangles, points @ gradient.T)
    torch.testing.assert_close(found, gradient.expand_as(found), rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    "third",
    [
        pytest.param([2.0, 0.0], id="collinear"),
        pytest.param([1.0, 0.0], id="duplicate"),
        pytest.param([0.5, 1e-3], id="flat sliver"),
        pytest.param([1e-3, 0.0], id="collinear, close"),
        pytest.param([float("nan"), 1.0], id="NaN"),
        pytest.param([float("inf"), 1.0], id="infinite"),
    ],
)
def test_a_triangle_without_a_gradient_is_nan(third: list[float]) -> None:
    points = UNIT_TRIANGLE.clone()
    points[0, 2] = torch.tensor(third)
    gradient = triangle_gradients(points, torch.tensor([[0, 1, 2], [0, 0, 0], [0, 1, 1]]), points.nan_to_num(0, 0, 0))
    assert gradient.isnan().all()


@pytest.mark.parametrize("index", [-1, -2, -4, 3, 100])
def test_an_index_outside_the_points_is_nan_and_does_not_wrap_round(index: int) -> None:
    triangles = torch.tensor([[0, 1, 2], [0, 1, index]])
    gradient = triangle_gradients(UNIT_TRIANGLE, triangles, UNIT_TRIANGLE)
    assert gradient[0, 0].isfinite().all()
    assert gradient[0, 1].isnan().all()
    assert triangle_areas(UNIT_TRIANGLE, triangles)[0].isnan().tolist() == [False, True]


def test_areas_and_quality() -> None:
    height = 3**0.5 / 2
    points = torch.tensor([[[0, 0], [1, 0], [0.5, height], [0.5, -height], [0, 1], [2, 0]]], dtype=torch.float64)
    triangles = torch.tensor([[0, 1, 2], [0, 1, 3], [0, 1, 4], [0, 1, 5], [0, 0, 0]])
    expected_areas = torch.tensor([[height / 2, height / 2, 0.5, 0.0, 0.0]], dtype=torch.float64)
    expected_quality = torch.tensor([[1.0, 1.0, height, 0.0, 0.0]], dtype=torch.float64)
    torch.testing.assert_close(triangle_areas(points, triangles), expected_areas)
    torch.testing.assert_close(triangle_quality(points, triangles), expected_quality)
    turn = torch.tensor([[0.8, -0.6], [0.6, 0.8]], dtype=torch.float64)
    torch.testing.assert_close(triangle_quality(1e-3 * points @ turn.T + 7, triangles), expected_quality)
