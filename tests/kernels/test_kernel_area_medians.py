"""The compiled medians over an area beside the portable ones in double: sums run in another order."""

from collections.abc import Callable
from typing import Any

import pytest
import torch

from fingerflow import kernels
from fingerflow.ops.area_medians import AreaMedians, area_medians

Portable = Callable[[Callable[[], object]], Any]
SETTINGS: dict[str, Any] = {
    "measure": 0,
    "minimum_points": 5,
    "radius": 1.0,
    "least_spread": 0.1,
    "farthest": 0.3,
    "least_ratio": 0.1,
    "least_share": 0.85,
    "reach": 2.0,
    "even": 0.4,
}


def random(*shape: int, seed: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.mark.parametrize("measure", ["green_lagrange", "as_printed", "infinitesimal"])
@pytest.mark.parametrize(
    ("points", "unknown", "noisy"), [(700, 0.0, True), (700, 0.3, True), (50, 0.0, False), (0, 0.0, True)]
)
def test_same_medians(
    instruction_set: int,
    portable: Portable,
    torch_threads: Callable[[int], None],
    points: int,
    unknown: float,
    noisy: bool,
    measure: str,
) -> None:
    """Rough displacements, ellipses in the cloud, over its border and beyond it, of all sizes."""
    batch = 9
    reference, displacement = 12 * random(1, points, 2, seed=1) + 50, 0.3 * random(batch, points, 2, seed=2)
    displacement = displacement + 0.05 * (reference - 50)
    displacement.masked_fill_(random(batch, points, 1, seed=3) < unknown, torch.nan)
    root = 0.01 * random(batch, points, 2, 2, seed=4)
    covariance = root @ root.mT if noisy else None
    center, axes = 56.5 + 3 * random(batch, 2, seed=5), 0.02 + 5 * random(batch, 2, seed=6) ** 2
    center[0], axes[1, 0], axes[2] = 1000.0, 0.0, 100.0
    angle = 6 * random(batch, seed=7)

    def call(kind: torch.dtype) -> AreaMedians:
        given = (tensor.to(kind) for tensor in (reference, displacement, center, axes, angle))
        own = None if covariance is None else covariance.to(kind)
        return area_medians(*given, gauge_length=2.0, measure=measure, covariance=own)

    torch_threads(1)
    found = call(torch.float32)
    expected = portable(lambda: call(torch.float64))
    assert torch.equal(found.median.isfinite(), expected.median.isfinite())
    # A position at a limit may count here and not there.
    torch.testing.assert_close(found.known.double(), expected.known, rtol=0, atol=3 / 800, equal_nan=True)
    if points == 700 and not unknown:
        assert found.median.isfinite().all(1).sum() > 3
    torch.testing.assert_close(found.median.double(), expected.median, rtol=1e-4, atol=1e-4, equal_nan=True)
    if noisy:
        torch.testing.assert_close(found.std.double(), expected.std, rtol=2e-2, atol=1e-6, equal_nan=True)  # type: ignore[union-attr]
    torch_threads(3)
    for one, other in zip(call(torch.float32), found, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=0, equal_nan=True)


def test_refusals() -> None:
    reference, displacement, ellipses, lattice = (
        torch.zeros(1, 5, 2),
        torch.zeros(3, 5, 2),
        torch.ones(3, 6),
        torch.zeros(4, 2),
    )
    with pytest.raises(ValueError, match="reference"):
        kernels.area_medians(reference.expand(2, 5, 2), displacement, ellipses, None, lattice, **SETTINGS)
    with pytest.raises(ValueError, match="displacement is"):
        kernels.area_medians(reference, displacement.double(), ellipses, None, lattice, **SETTINGS)
    with pytest.raises(ValueError, match="covariance"):
        kernels.area_medians(reference, displacement, ellipses, torch.zeros(3, 5), lattice, **SETTINGS)
    with pytest.raises(ValueError, match="0 positions"):
        kernels.area_medians(reference, displacement, ellipses, None, lattice[:0], **SETTINGS)
