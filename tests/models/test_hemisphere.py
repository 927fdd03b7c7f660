"""Tests of the flattened half-sphere against 60 digits and against statements of the paper."""

import math

import mpmath
import pytest
import torch

from fingerflow.models.hemisphere import arc_length, contact_radius, radial_strain

RATIOS = [1e-300, 1e-16, 1e-6, 0.1, 0.2499999, 0.25, 0.7, 1.0]


@pytest.mark.parametrize("ratio", RATIOS)
def test_equations_9_and_10_to_the_last_digits(ratio: float) -> None:
    with mpmath.workdps(700):
        t = mpmath.mpf(ratio)
        arc, radius = mpmath.acos(1 - t), mpmath.sqrt(1 - (1 - t) ** 2)
        expected = [float((arc - radius) / arc), float(arc), float(radius)]
    found = [function(torch.tensor(ratio, dtype=torch.float64), 1.0).item() for function in ALL]
    assert found == pytest.approx(expected, rel=2e-15, abs=0)


ALL = (radial_strain, arc_length, contact_radius)


def test_depth_zero_is_no_strain() -> None:
    assert [function(0.0, 5.0).item() for function in ALL] == [0, 0, 0]


def test_differentiable_at_every_depth() -> None:
    depth = torch.tensor([0.0, 1e-9, 0.1, 0.26, 0.8], dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(radial_strain(depth, 1.0).sum(), depth)
    assert slope[0].item() == pytest.approx(1 / 3)
    depth = torch.tensor([0.05, 0.2, 0.3, 0.8], dtype=torch.float64, requires_grad=True)
    radius = torch.tensor(1.3, dtype=torch.float64, requires_grad=True)
    assert all(torch.autograd.gradcheck(function, (depth, radius)) for function in ALL)


@pytest.mark.parametrize("depth", [-1e-9, 1.0001, math.nan, math.inf])
def test_impossible_depths_are_refused(depth: float) -> None:
    for function in ALL:
        with pytest.raises(ValueError, match=r"0 to its radius"):
            function(torch.tensor([0.5, depth], dtype=torch.float64), 1.0)


@pytest.mark.parametrize("radius", [0.0, math.nan, math.inf])
def test_impossible_radii_are_refused(radius: float) -> None:
    with pytest.raises(ValueError, match=f"radius {radius}"):
        radial_strain(0.0, radius)
