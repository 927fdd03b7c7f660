"""Tests of divergence, curl, shear, strain and energy against known deformations and against the printed formulas."""

import math

import pytest
import torch
from torch import Tensor

from fingerflow.ops import curl, divergence, green_lagrange, strain_energy_density
from fingerflow.ops.fields.strain import principal_deviations, principal_strains, shear


def rotation(angle: float) -> Tensor:
    return torch.tensor([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]], dtype=torch.float64)


IDENTITY = torch.eye(2, dtype=torch.float64)


def random_gradients(count: int = 50, size: float = 0.3) -> Tensor:
    return size * torch.randn(count, 2, 2, generator=torch.Generator().manual_seed(4), dtype=torch.float64)


def test_divergence_and_curl_have_their_signs() -> None:
    gradient = torch.tensor([[1.0, 10.0], [100.0, 1000.0]])
    assert divergence(gradient).item() == 1001.0
    assert curl(gradient).item() == 90.0
    assert shear(gradient).tolist() == [-999.0, 110.0]


def test_rotating_a_stretched_finger_changes_the_printed_strain_only() -> None:
    """The printed exy lacks (u_x u_y + v_x v_y) / 2, so it depends on the rotation after the stretch."""
    gradient = rotation(0.3) @ torch.tensor([[1.2, 0.0], [0.0, 0.9]], dtype=torch.float64) - IDENTITY
    expected = torch.tensor([0.22, -0.095, 0.0], dtype=torch.float64)
    torch.testing.assert_close(green_lagrange(gradient), expected, atol=1e-15, rtol=0)
    printed = green_lagrange(gradient, "as_printed")
    torch.testing.assert_close(printed[:2], expected[:2], atol=1e-15, rtol=0)
    # (u_y + v_x) / 2 = sin(0.3) (1.2 - 0.9) / 2
    assert printed[2].item() == pytest.approx(0.15 * math.sin(0.3), abs=1e-15)


def test_full_strain_is_half_of_f_transposed_f_minus_identity() -> None:
    gradient = random_gradients()
    deformation = IDENTITY + gradient
    tensor = (deformation.mT @ deformation - IDENTITY) / 2
    expected = torch.stack((tensor[:, 0, 0], tensor[:, 1, 1], tensor[:, 0, 1]), dim=-1)
    torch.testing.assert_close(green_lagrange(gradient), expected, atol=1e-15, rtol=0)


def test_simple_shear_and_uniaxial_stretch() -> None:
    shear_by = torch.tensor([[0.0, 0.2], [0.0, 0.0]], dtype=torch.float64)
    stretch_by = torch.tensor([[0.2, 0.0], [0.0, 0.0]], dtype=torch.float64)
    for gradient, measure, expected in (
        (shear_by, "green_lagrange", [0.0, 0.02, 0.1]),
        (shear_by, "as_printed", [0.0, 0.02, 0.1]),
        (shear_by, "infinitesimal", [0.0, 0.0, 0.1]),
        (stretch_by, "green_lagrange", [0.22, 0.0, 0.0]),
        (stretch_by, "infinitesimal", [0.2, 0.0, 0.0]),
        (stretch_by.flip(0, 1), "infinitesimal", [0.0, 0.2, 0.0]),
        (shear_by.T, "infinitesimal", [0.0, 0.0, 0.1]),
    ):
        strain = green_lagrange(gradient, measure)
        torch.testing.assert_close(strain, torch.tensor(expected, dtype=torch.float64), atol=1e-15, rtol=0)


def test_principal_strains_are_eigenvalues_and_their_direction() -> None:
    strain = green_lagrange(random_gradients())
    exx, eyy, exy = strain.unbind(-1)
    tensor = torch.stack((exx, exy, exy, eyy), dim=-1).reshape(-1, 2, 2)
    principal, angle = principal_strains(strain)
    torch.testing.assert_close(principal, torch.linalg.eigvalsh(tensor).flip(-1), atol=1e-14, rtol=0)
    direction = torch.stack((angle.cos(), angle.sin()), dim=-1)[..., None]
    torch.testing.assert_close(tensor @ direction, principal[:, :1, None] * direction, atol=1e-14, rtol=0)


def test_deviations_of_principal_strains_are_those_of_draws() -> None:
    """Principal strains and angles of 20,000 strains with random errors scatter by their standard deviations, to 3 %.
    Where the strain is 0, all directions are equally likely, and the angle does so to 10 %.
    """
    draws = torch.Generator().manual_seed(3)
    std = torch.tensor([0.001, 0.002, 0.0015], dtype=torch.float64)
    errors = std * torch.randn(20_000, 3, generator=draws, dtype=torch.float64)
    strain = torch.tensor([0.02, -0.01, 0.012], dtype=torch.float64)
    true, angle = principal_strains(strain)
    measured, turned = principal_strains(strain + errors)
    stated = [part.mean(0) for part in principal_deviations(strain + errors, std.expand_as(errors))]
    torch.testing.assert_close((measured - true).square().mean(0).sqrt(), stated[0], rtol=0.03, atol=0)
    torch.testing.assert_close((turned - angle).square().mean().sqrt(), stated[1], rtol=0.03, atol=0)
    _, turned = principal_strains(errors / 100)
    _, stated_angle = principal_deviations(errors / 100, std.expand_as(errors))
    torch.testing.assert_close(turned.square().mean().sqrt(), stated_angle.mean(), rtol=0.1, atol=0)


def test_equal_principal_strains_have_no_direction_and_a_finite_derivative() -> None:
    strain = torch.tensor([[0.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.5, 0.25, 0.0]], dtype=torch.float64, requires_grad=True)
    principal, angle = principal_strains(strain)
    assert principal.tolist() == [[0.0, 0.0], [0.5, 0.5], [0.5, 0.25]]
    assert angle.isnan().tolist() == [True, True, False]
    (principal.sum() + angle.nansum()).backward()
    assert strain.grad is not None
    assert strain.grad.isfinite().all()


def hooke_plane_strain(strain: Tensor, young: float, poisson: float) -> Tensor:
    """Return the stress (sxx, syy, sxy) of a plane strain by Lame's constants, independent of the energy formula."""
    first = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    second = young / (2 * (1 + poisson))
    exx, eyy, exy = strain.unbind(-1)
    volume = first * (exx + eyy)
    return torch.stack((volume + 2 * second * exx, volume + 2 * second * eyy, 2 * second * exy), dim=-1)


@pytest.mark.parametrize(("young", "poisson"), [(1.0, 0.4), (1.54, 0.0), (0.025, 0.49), (2.0, -0.7)])
def test_the_energy_derives_into_hookes_stress(young: float, poisson: float) -> None:
    strain = green_lagrange(random_gradients()).requires_grad_()
    energy = strain_energy_density(strain, young, poisson)
    (derivative,) = torch.autograd.grad(energy.sum(), strain)
    stress = hooke_plane_strain(strain.detach(), young, poisson)
    work = torch.tensor([1.0, 1.0, 2.0], dtype=torch.float64)  # exy counts twice in stress : strain
    torch.testing.assert_close(derivative, stress * work)
    torch.testing.assert_close(energy.detach(), (stress * work * strain.detach()).sum(-1) / 2)
