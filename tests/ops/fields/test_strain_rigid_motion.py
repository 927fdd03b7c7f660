"""Tests of the residual after the best rigid motion: zero for a rigid motion, else the deformation that was added."""

import math

import numpy as np
import pytest
import torch
from scipy.optimize import minimize
from torch import Tensor

from fingerflow.ops.fields.rigid_motion import rigid_residual


def cloud(batch: int = 1, count: int = 30) -> Tensor:
    return 10 * torch.rand(batch, count, 2, generator=torch.Generator().manual_seed(15), dtype=torch.float64)


def rigid_displacement(points: Tensor, angle: float, shift: tuple[float, float] = (3.0, -2.0)) -> Tensor:
    turn = torch.tensor([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]], dtype=torch.float64)
    return points @ turn.T + torch.tensor(shift, dtype=torch.float64) - points


def wobble(points: Tensor, size: float) -> Tensor:
    return size * torch.randn(points.shape, generator=torch.Generator().manual_seed(16), dtype=torch.float64)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.2, -2.0, math.pi])
def test_a_rigid_motion_leaves_nothing(angle: float) -> None:
    points = cloud(3)
    residual = rigid_residual(points, rigid_displacement(points, angle))
    torch.testing.assert_close(residual, torch.zeros_like(points), atol=1e-13, rtol=0)


def test_the_rigid_residual_is_the_least_squares_minimum() -> None:
    points = cloud()
    displacement = rigid_displacement(points, 0.3) + wobble(points, 1.0)
    weights = 0.1 + torch.rand(1, 30, generator=torch.Generator().manual_seed(17), dtype=torch.float64)

    def residual_of(motion: np.ndarray) -> np.ndarray:
        return (displacement - rigid_displacement(points, motion[0], (motion[1], motion[2]))).numpy()[0]

    def cost(motion: np.ndarray) -> float:
        return float((weights.numpy()[0, :, None] * residual_of(motion) ** 2).sum())

    best = minimize(cost, np.zeros(3), tol=1e-14)
    # The minimiser stops at the square root of its precision.
    np.testing.assert_allclose(rigid_residual(points, displacement, weights)[0], residual_of(best.x), atol=1e-5)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_missing_points_have_no_part(bad: float) -> None:
    points = cloud()
    displacement = rigid_displacement(points, 0.1) + wobble(points, 0.1)
    clean = rigid_residual(points[:, 3:], displacement[:, 3:])
    points[0, 0, 0], displacement[0, 1, 1] = bad, bad
    weights = torch.ones(1, 30, dtype=torch.float64)
    weights[0, 2] = bad
    residual = rigid_residual(points, displacement, weights)
    torch.testing.assert_close(residual[:, 3:], clean, atol=1e-13, rtol=0)
    assert residual[0, :2].isnan().all()
    assert residual[0, 2].isfinite().all()


@pytest.mark.parametrize("offset", [0.0, 1e5])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("count", [0, 1, 50])
def test_one_place_determines_no_rotation(count: int, dtype: torch.dtype, offset: float) -> None:
    """Points at one position determine no rotation, so the residual is NaN. Weighted sums round the centroid off that
    position in about half of these 50 frames; this distance must not determine a rotation.
    """
    generator = torch.Generator().manual_seed(19)
    places = torch.rand(50, 1, 2, generator=generator, dtype=torch.float64) + offset
    points = places.to(dtype).expand(-1, count, -1)
    for fitted in (None, torch.rand(50, count, generator=generator, dtype=torch.float64).to(dtype)):
        assert rigid_residual(points, wobble(points, 1.0).to(dtype), fitted).isnan().all()
