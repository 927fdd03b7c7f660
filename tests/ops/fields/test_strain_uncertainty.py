"""Tests of the covariance of the fitted gradient and of the standard deviations of divergence, curl and strain."""

import math

import pytest
import torch
from torch import Tensor

from fingerflow.ops import curl, divergence, green_lagrange, local_gradients, strain_energy_density
from fingerflow.ops.fields.strain import strain_energy_density_std
from fingerflow.ops.fields.strain_uncertainty import curl_std, divergence_std, field_std

GAUGE = 2.0
MEASURES = ("green_lagrange", "as_printed", "infinitesimal")


def scene() -> tuple[Tensor, Tensor, Tensor]:
    """Return points (1, 60, 2), three queries (1, 3, 2) and a covariance (1, 60, 2, 2) that differs from point to
    point.
    """
    generator = torch.Generator().manual_seed(11)
    points = 3 * torch.rand(1, 60, 2, generator=generator, dtype=torch.float64)
    queries = torch.tensor([[[1.5, 1.5], [1.0, 2.0], [0.3, 0.3]]], dtype=torch.float64)
    factor = 0.01 * torch.randn(1, 60, 2, 2, generator=generator, dtype=torch.float64)
    return points, queries, factor @ factor.mT


def test_the_covariance_is_that_of_the_linear_estimator() -> None:
    """The covariance is J S J', where J is the derivative of the gradient by the values, from autograd."""
    points, queries, covariance = scene()

    def gradient(values: Tensor) -> Tensor:
        return local_gradients(points, values, queries, gauge_length=GAUGE).gradient[0]

    jacobian = torch.autograd.functional.jacobian(gradient, torch.zeros_like(points))[..., 0, :, :]  # (Q, C, 2, N, C)
    expected = torch.einsum("qijnc,ncd,qklnd->qijkl", jacobian, covariance[0], jacobian)
    fit = local_gradients(points, points, queries, gauge_length=GAUGE, variance=covariance)
    assert fit.covariance is not None
    torch.testing.assert_close(fit.covariance[0], expected, atol=1e-15, rtol=1e-10)


@pytest.mark.parametrize("measure", MEASURES)
def test_strain_deviation_uses_the_derivative_of_that_measure(measure: str) -> None:
    generator = torch.Generator().manual_seed(13)
    gradient = 0.3 * torch.randn(2, 2, generator=generator, dtype=torch.float64)
    factor = torch.randn(4, 4, generator=generator, dtype=torch.float64)
    covariance = factor @ factor.T

    def fields(gradient: Tensor) -> Tensor:
        return torch.cat((torch.stack((divergence(gradient), curl(gradient))), green_lagrange(gradient, measure)))

    jacobian = torch.autograd.functional.jacobian(fields, gradient).reshape(5, 4)
    expected = (jacobian @ covariance @ jacobian.T).diagonal().sqrt()
    covariance = covariance.reshape(2, 2, 2, 2)
    torch.testing.assert_close(field_std(gradient, covariance, measure), expected)
    alone = torch.stack((divergence_std(covariance), curl_std(covariance)))
    torch.testing.assert_close(alone, expected[:2])


@pytest.mark.parametrize("bad", [math.nan, math.inf, -1e-4])
def test_a_point_without_a_usable_variance_is_left_out(bad: float) -> None:
    points, queries, covariance = scene()
    values = points.sin()
    isotropic, full = covariance[..., 0, 0].clone(), covariance.clone()
    isotropic[0, :5] = bad
    full[0, :5, 1, 1] = bad
    for variance, clean in ((isotropic, covariance[..., 0, 0]), (full, covariance)):
        fit = local_gradients(points, values, queries, gauge_length=GAUGE, variance=variance)
        rest = local_gradients(points[:, 5:], values[:, 5:], queries, gauge_length=GAUGE, variance=clean[:, 5:])
        assert fit.covariance is not None
        assert rest.covariance is not None
        torch.testing.assert_close(fit.gradient, rest.gradient, atol=1e-12, rtol=0)
        torch.testing.assert_close(fit.covariance, rest.covariance, atol=1e-15, rtol=1e-10)


@pytest.mark.parametrize("strain", [(0.0, 0.0, 0.0), (0.02, -0.01, 0.01), (0.05, 0.03, 0.0)])
def test_deviation_of_the_energy_density_is_its_error(strain: tuple[float, float, float]) -> None:
    exact, std = torch.tensor([strain, (0.005, 0.008, 0.003)], dtype=torch.float64)
    errors = torch.randn(20_000, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    measured = exact + std * errors
    error = (strain_energy_density(measured) - strain_energy_density(exact)).square().mean().sqrt()
    stated = strain_energy_density_std(measured, std, 1.0, 0.4).square().mean().sqrt()
    assert 0.75 < error / stated < 1.05
