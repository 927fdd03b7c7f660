"""The compiled medians over an area beside the portable ones in double: sums run in another order."""

from collections.abc import Callable
from typing import Any

import pytest
import torch

from fingerflow.kernels import tensors as kernels
from fingerflow.ops.fields.area_medians import Apart, AreaMedians, area_medians

Portable = Callable[[Callable[[], object]], Any]
SETTINGS: dict[str, Any] = {"measure": 0, "radius": 1.0}
NOBODY = (None, None, None)


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


@pytest.mark.parametrize("noisy", [True, False])
def test_same_medians_with_points_apart(instruction_set: int, portable: Portable, noisy: bool) -> None:
    """A third of the points, on one side, of some of which nothing is known."""
    batch, points = 5, 700
    reference, displacement = 12 * random(1, points, 2, seed=1), 0.1 * random(batch, points, 2, seed=2)
    displacement.masked_fill_(random(batch, points, 1, seed=3) < 0.1, torch.nan)
    among = (reference[..., 0] < 4).expand(batch, points) & (random(batch, points, seed=8) < 0.9)
    fields = 0.2 * random(batch, points, 5, seed=9).masked_fill(random(batch, points, 1, seed=10) < 0.2, torch.nan)
    std = 0.05 * random(batch, points, 5, seed=11)
    covariance = 1e-4 * torch.eye(2, dtype=torch.float64).expand(batch, points, 2, 2) if noisy else None
    center, axes = 5 + 2 * random(batch, 2, seed=5), 2 + 2 * random(batch, 2, seed=6)

    def call(kind: torch.dtype) -> AreaMedians:
        given = (tensor.to(kind) for tensor in (reference, displacement, center, axes, center[:, 0]))
        own = None if covariance is None else covariance.to(kind)
        apart = Apart(among, fields.to(kind), std.to(kind) if noisy else None)
        return area_medians(*given, gauge_length=2.0, covariance=own, apart=apart)

    found, expected = call(torch.float32), portable(lambda: call(torch.float64))
    assert found.median.isfinite().all()
    torch.testing.assert_close(found.known.double(), expected.known, rtol=0, atol=3 / 800)
    # A position between two points, as far from both, may have the field of either: a rank more or less of 800.
    torch.testing.assert_close(found.median.double(), expected.median, rtol=0, atol=1e-3)
    if noisy:
        torch.testing.assert_close(found.std.double(), expected.std, rtol=2e-2, atol=1e-6)  # type: ignore[union-attr]


def test_refusals() -> None:
    reference, displacement, ellipses = torch.zeros(1, 5, 2), torch.zeros(3, 5, 2), torch.ones(3, 6)
    with pytest.raises(ValueError, match="reference"):
        kernels.area_medians(reference.expand(2, 5, 2), displacement, ellipses, None, *NOBODY, **SETTINGS)
    with pytest.raises(ValueError, match="displacement is"):
        kernels.area_medians(reference, displacement.double(), ellipses, None, *NOBODY, **SETTINGS)
    with pytest.raises(ValueError, match="covariance"):
        kernels.area_medians(reference, displacement, ellipses, torch.zeros(3, 5), *NOBODY, **SETTINGS)
    apart, fields = torch.ones(3, 5, dtype=torch.bool), torch.zeros(3, 5, 5)
    with pytest.raises(ValueError, match="apart_fields"):
        kernels.area_medians(reference, displacement, ellipses, None, apart, fields[:2], None, **SETTINGS)
    with pytest.raises(ValueError, match="deviations"):
        kernels.area_medians(reference, displacement, ellipses, None, apart, fields, fields, **SETTINGS)
    with pytest.raises(ValueError, match="measure 3"):
        kernels.area_medians(reference, displacement, ellipses, None, *NOBODY, measure=3, radius=1.0)
