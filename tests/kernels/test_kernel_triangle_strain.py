"""The compiled strain of triangles beside the portable one in double: sums run in another order."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from scipy.spatial import Delaunay

from fingerflow.kernels import tensors as kernels
from fingerflow.ops.fields.triangle_strain import SharedErrors, TriangleStrain, triangle_strain

Portable = Callable[[Callable[[], object]], Any]


def random(*shape: int, seed: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.mark.parametrize("measure", ["green_lagrange", "as_printed", "infinitesimal"])
@pytest.mark.parametrize(("points", "unknown"), [(700, 0.0), (701, 0.1), (700, 0.6), (3, 0.0)])
def test_same_strain(
    instruction_set: int,
    portable: Portable,
    torch_threads: Callable[[int], None],
    points: int,
    unknown: float,
    measure: str,
) -> None:
    batch = 9
    reference, displacement = 12 * random(1, points, 2, seed=1), 0.05 * random(batch, points, 2, seed=2)
    displacement.masked_fill_(random(batch, points, 1, seed=3) < unknown, torch.nan)
    root = 0.01 * random(batch, points, 2, 2, seed=4)
    covariance = root @ root.mT
    covariance.masked_fill_(displacement.isnan().any(-1)[..., None, None], torch.nan)
    triangles = torch.from_numpy(Delaunay(reference[0].numpy()).simplices).long()
    in_contact = random(batch, len(triangles), seed=5) < 0.7
    in_contact[0] = False
    pairs = torch.randint(points, (50, 2), generator=torch.Generator().manual_seed(7))
    shared = SharedErrors(0.9 * random(len(triangles), 3, seed=6).float(), pairs, 0.9 * random(50, seed=8).float())

    def call(kind: torch.dtype) -> TriangleStrain:
        # Both from the same numbers of 32 bit: narrow triangles are sensitive to places.
        position, moved, errors = (tensor.float().to(kind) for tensor in (reference, displacement, covariance))
        solid = {"young_modulus_mpa": 0.3, "poisson_ratio": 0.45}
        together = None if measure == "infinitesimal" else shared._replace(correlation=shared.correlation.to(kind))
        return triangle_strain(position, triangles, moved, errors, in_contact, together, measure=measure, **solid)

    torch_threads(1)
    found = call(torch.float32)
    expected = portable(lambda: call(torch.float64))
    for name in ("strain", "strain_std", "density"):
        torch.testing.assert_close(
            getattr(found, name).double(), getattr(expected, name), rtol=1e-5, atol=1e-5, equal_nan=True
        )
    for name in ("energy", "energy_std"):
        torch.testing.assert_close(getattr(found, name), getattr(expected, name), rtol=1e-5, atol=0, equal_nan=True)
    torch_threads(2)
    for first, second in zip(found, call(torch.float32), strict=True):
        torch.testing.assert_close(first, second, rtol=0, atol=0, equal_nan=True)


def test_what_does_not_belong_together_is_refused() -> None:
    triangles, none = torch.tensor([[0, 1, 2]]), torch.zeros(1)
    slopes, displacement, covariance = torch.zeros(1, 3, 2), torch.zeros(1, 3, 2), torch.zeros(1, 3, 2, 2)
    in_contact, products = torch.ones(1, 1, dtype=torch.bool), torch.zeros(3, 3, 1)
    settings: dict[str, Any] = {"measure": 0, "stiffness": (1.0, 1.0, 1.0)}
    rest = (slopes, products, none, none)
    kernels.triangle_strain(triangles, *rest, displacement, covariance, in_contact, **settings)
    with pytest.raises(ValueError, match="triangles of 3 points"):
        kernels.triangle_strain(triangles + 1, *rest, displacement, covariance, in_contact, **settings)
    with pytest.raises(ValueError, match="covariance is"):
        kernels.triangle_strain(triangles, *rest, displacement, covariance[:, :2], in_contact, **settings)
    with pytest.raises(ValueError, match="displacement is"):
        kernels.triangle_strain(triangles, *rest, displacement.double(), covariance, in_contact, **settings)
