"""Tests of the local linear fit against linear, quadratic and sinusoidal fields, and against NumPy's least squares."""

import math

import numpy as np
import pytest
import torch
from scipy.integrate import quad
from scipy.special import jv
from torch import Tensor

from fingerflow.ops.fields.local_fit import local_gradients

GRADIENT = torch.tensor([[0.03, -0.07], [0.05, 0.02]], dtype=torch.float64)
GAUGE = 2.0


def cloud(batch: int = 1, count: int = 200, size: float = 6.0, seed: int = 5) -> Tensor:
    """Return points (batch, count, 2), uniform over a square of `size`: by default 14 in a support of diameter 2."""
    generator = torch.Generator().manual_seed(seed)
    return size * torch.rand(batch, count, 2, generator=generator, dtype=torch.float64)


def inner_queries(count: int) -> Tensor:
    """Return queries (1, count, 2) inside the cloud."""
    return 1 + cloud(count=count, size=4.0, seed=7)


def noise_like(tensor: Tensor, seed: int = 6) -> Tensor:
    return torch.randn(tensor.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def dense_lattice(spacing: float, radius: float) -> Tensor:
    """Return a square lattice (1, N, 2) around the origin that fills the support of this radius."""
    axis = torch.arange(-radius, radius + spacing / 2, spacing, dtype=torch.float64)
    return torch.cartesian_prod(axis, axis)[None]


def fit_one_by_one(points: Tensor, values: Tensor, query: Tensor, gauge: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the coefficients (3, C) of the plane at the query and the estimator (3, N), by NumPy's least squares."""
    offsets = (points - query).numpy()
    weight = np.clip(1 - (offsets**2).sum(-1) / (gauge / 2) ** 2, 0, None) ** 2
    design = np.column_stack((np.ones(len(offsets)), offsets))
    root = np.sqrt(weight)[:, None]
    estimator = np.linalg.pinv(root * design) * root.T
    return estimator @ values.numpy(), estimator


def test_the_same_as_least_squares_done_one_by_one() -> None:
    points = cloud()
    values = noise_like(points)
    queries = inner_queries(10)
    fit = local_gradients(points, values, queries, gauge_length=GAUGE)
    for index, query in enumerate(queries[0]):
        coefficients, _ = fit_one_by_one(points[0], values[0], query, GAUGE)
        np.testing.assert_allclose(fit.value[0, index], coefficients[0], atol=1e-12)
        np.testing.assert_allclose(fit.gradient[0, index], coefficients[1:].T, atol=1e-12)
        assert fit.point_count[0, index] == int(((points[0] - query).norm(dim=-1) < GAUGE / 2).sum())


@pytest.mark.parametrize("waves_per_gauge", [0.125, 0.25, 0.5, 1.0])
def test_a_sinusoid_is_attenuated_as_the_docstring_says(waves_per_gauge: float) -> None:
    """The fit attenuates a sinusoid as the docstring states.

    The reference is the continuous fit, integrated in float64; integrated over y its weight is (1 - x^2)^(5/2).
    """
    radius, wave_number = GAUGE / 2, 2 * math.pi * waves_per_gauge / GAUGE

    def weight(x: float) -> float:
        return (1 - x * x) ** 2.5

    slope = quad(lambda x: weight(x) * x * math.sin(wave_number * radius * x), -1, 1)[0]
    slope /= quad(lambda x: weight(x) * x * x, -1, 1)[0] * radius * wave_number
    height = quad(lambda x: weight(x) * math.cos(wave_number * radius * x), -1, 1)[0]
    height /= quad(weight, -1, 1)[0]

    points = dense_lattice(radius / 40, radius)
    phase = wave_number * points[..., 0]
    values = torch.stack((phase.sin() / wave_number, phase.cos()), dim=-1)
    fit = local_gradients(points, values, torch.zeros(1, 1, 2, dtype=torch.float64), gauge_length=GAUGE)
    # 1e-5: the sum over 40 points a radius against the integral of a weight with two continuous derivatives.
    assert fit.gradient[0, 0, 0, 0].item() == pytest.approx(slope, abs=1e-5)
    assert fit.value[0, 0, 1].item() == pytest.approx(height, abs=1e-5)

    argument = math.pi * waves_per_gauge
    assert slope == pytest.approx(384 * jv(4, argument) / argument**4, abs=1e-8)
    assert height == pytest.approx(48 * jv(3, argument) / argument**3, abs=1e-8)


LINE = [[-0.4, -0.2], [-0.2, -0.1], [0.0, 0.0], [0.2, 0.1], [0.4, 0.2], [0.6, 0.3]]


@pytest.mark.parametrize(
    "support",
    [
        pytest.param([], id="no point"),
        pytest.param([[0.1, 0.1]], id="one point"),
        pytest.param([[0.1, 0.1], [-0.1, 0.2]], id="two points"),
        pytest.param([[0.1, 0.1]] * 8, id="duplicates"),
        pytest.param([[0.1, 0.1]] * 4 + [[-0.3, 0.2]] * 4, id="two places"),
        pytest.param(LINE, id="collinear"),
        pytest.param([[x, y + 1e-3 * (-1) ** i] for i, (x, y) in enumerate(LINE)], id="nearly collinear"),
        pytest.param([[5.0, 0.0], [0.0, 5.0], [5.0, 5.0], [-5.0, 0.0], [0.0, -5.0]], id="all outside the support"),
        pytest.param([[0.9999, 0.0], [0.0, 0.9999], *([[0.0, 0.0]] * 4)], id="spread by points of no weight"),
    ],
)
@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e6])
def test_supports_that_determine_no_plane_are_nan_at_any_scale(support: list[list[float]], scale: float) -> None:
    points = scale * torch.tensor(support, dtype=torch.float64).reshape(1, -1, 2)
    query = torch.zeros(1, 1, 2, dtype=torch.float64)
    fit = local_gradients(
        points, points, query, gauge_length=GAUGE * scale, minimum_points=3, variance=points[..., 0].abs()
    )
    assert fit.gradient.isnan().all()
    assert fit.value.isnan().all()
    assert fit.centroid_offset.isnan().all()
    assert fit.covariance is not None
    assert fit.covariance.isnan().all()


@pytest.mark.usefixtures("each_form")
def test_points_on_the_rim_are_outside() -> None:
    """Points on the rim of the support do not count; distances between whole numbers are exact, so the count does not
    depend on the order of sums.
    """
    axis = torch.arange(40.0)
    points = torch.cartesian_prod(axis, axis)[None]
    inside = torch.cdist(points[0], points[0]).square().round() < 25
    assert torch.equal(local_gradients(points, points, gauge_length=10.0).point_count[0], inside.sum(1))


def test_float32_far_from_the_origin() -> None:
    points = (cloud() + 1e5).float()  # spacing of float32 here: 0.0078
    values = ((points.double() - 1e5) @ GRADIENT.T).float()
    fit = local_gradients(points, values, gauge_length=GAUGE)
    truth = local_gradients(points.double(), values.double(), gauge_length=GAUGE)
    assert torch.equal(fit.point_count, truth.point_count)
    assert fit.gradient.isfinite().float().mean() > 0.95
    # eps x displacement of 0.5 over a spread of at least 0.1, some tens of roundings; raw moments would err by 1e2.
    torch.testing.assert_close(fit.gradient.double(), truth.gradient, atol=2e-5, rtol=0, equal_nan=True)
    torch.testing.assert_close(fit.value.double(), truth.value, atol=2e-6, rtol=0, equal_nan=True)
