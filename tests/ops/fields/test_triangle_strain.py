"""Tests of strain and energy of triangles in many frames against the ops of a single gradient."""

import pytest
import torch

from fingerflow.ops.fields.strain import green_lagrange, strain_energy_density
from fingerflow.ops.fields.triangle_strain import area_shares, triangle_strain
from fingerflow.ops.fields.triangles import triangle_areas, triangle_gradients

# Two squares of 2 mm side by side, and a flat triangle.
POINTS = torch.tensor([[[0.0, 0.0], [2, 0], [4, 0], [0, 2], [2, 2], [4, 2], [2, 0.01]]], dtype=torch.float64)
TRIANGLES = torch.tensor([[0, 1, 3], [1, 4, 3], [1, 2, 4], [2, 5, 4], [0, 2, 6]])


def moved(batch: int) -> torch.Tensor:
    return 0.1 * torch.randn(batch, 7, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64)


@pytest.mark.parametrize("measure", ["green_lagrange", "as_printed", "infinitesimal"])
def test_strain_density_and_energy_are_those_of_each_triangle(measure: str) -> None:
    displacement = moved(3)
    displacement[1, 5] = torch.nan
    in_contact = torch.tensor([[True] * 5, [True] * 5, [True, True, False, False, True]])
    exact = torch.zeros(3, 7, 2, 2, dtype=torch.float64)
    found = triangle_strain(POINTS, TRIANGLES, displacement, exact, in_contact, measure=measure, young_modulus_mpa=2.0)
    strain = green_lagrange(triangle_gradients(POINTS, TRIANGLES, displacement), measure)
    density = strain_energy_density(strain, 2.0)
    torch.testing.assert_close(found.strain, strain, equal_nan=True)
    torch.testing.assert_close(found.density, density, equal_nan=True)
    assert found.density[:, 4].isnan().all()
    assert found.density[1].isnan().tolist() == [False, False, False, True, True]
    shares = area_shares(in_contact, density.isfinite(), triangle_areas(POINTS, TRIANGLES))
    torch.testing.assert_close(found.energy, (shares * density.nan_to_num(0.0)).sum(1))
    assert (found.energy_std == 0).all()
    assert (found.strain_std.nan_to_num(0.0) == 0).all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("left_out", ["triangles", "contact", "displacements", "areas"])
def test_the_energy_of_nothing_is_not_a_number(left_out: str, dtype: torch.dtype) -> None:
    points, displacement, triangles = POINTS.to(dtype), moved(2).to(dtype), TRIANGLES
    in_contact = torch.ones(2, 5, dtype=torch.bool)
    if left_out == "triangles":
        triangles, in_contact = TRIANGLES[:0], in_contact[:, :0]
    elif left_out == "contact":
        in_contact = ~in_contact
    elif left_out == "displacements":
        displacement = torch.full_like(displacement, torch.nan)
    else:
        points = points * torch.tensor([1, 0], dtype=dtype)
    result = triangle_strain(points, triangles, displacement, torch.zeros(2, 7, 2, 2, dtype=dtype), in_contact)
    assert result.energy.isnan().all()
    assert result.energy_std.isnan().all()


@pytest.mark.parametrize("together", [0.0, 0.6])
def test_deviations_are_those_of_many_copies(together: float) -> None:
    """The stated deviations agree to 2 % with the scatter of 20,000 copies, whose errors are small and partly common to
    all points; that many copies know a deviation to 0.5 %.
    """
    draw = torch.Generator().manual_seed(2)
    # The energy treats common errors as isotropic.
    shape = torch.randn(7, 2, 2, generator=draw, dtype=torch.float64)
    root = 1e-3 * (shape if together == 0 else torch.eye(2, dtype=torch.float64).expand(7, 2, 2))
    covariance = (root @ root.mT)[None]
    copies = 20_000
    own, common = (torch.randn(copies, count, 2, generator=draw, dtype=torch.float64) for count in (7, 1))
    errors = ((1 - together) ** 0.5 * own + together**0.5 * common)[..., None, :] @ root.mT
    pairs = torch.combinations(torch.arange(7))
    shared = torch.full((5, 3), together), pairs, torch.full((len(pairs),), together)
    in_contact = torch.ones(1, 5, dtype=torch.bool)
    exact = moved(1)
    stated = triangle_strain(POINTS, TRIANGLES, exact, covariance, in_contact, shared, measure="infinitesimal")
    zero = torch.zeros_like(covariance)
    true = triangle_strain(POINTS, TRIANGLES, exact, zero, in_contact, measure="infinitesimal")
    found = triangle_strain(
        POINTS,
        TRIANGLES,
        exact + errors[..., 0, :],
        covariance.expand(copies, -1, -1, -1),
        in_contact.expand(copies, -1),
        shared,
        measure="infinitesimal",
    )
    torch.testing.assert_close(found.strain.std(0)[:4], stated.strain_std[0, :4], rtol=0.02, atol=0)
    assert float(found.energy.std()) == pytest.approx(float(stated.energy_std), rel=0.02)
    assert float(found.energy.mean() - true.energy) == pytest.approx(0, abs=4 * float(stated.energy_std) / copies**0.5)
