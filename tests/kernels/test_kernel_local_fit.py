"""The compiled local fit beside the portable one: both round, so that the portable one in float64 is the judge."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.ops.fields.local_fit import LocalFit, local_gradients

Portable = Callable[[Callable[[], object]], Any]

# Of a sum of n rounded products, and of the 2 x 2 system solved from such sums, in units of the type's rounding: a
# hundred for sums of up to 300 points, times the worst ratio of radius to spread that is let through, squared.
_ROUNDINGS = 100 / 0.1**2


def random(*shape: int, seed: int = 1) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def assert_same(found: LocalFit, expected: LocalFit, radius: float, dtype: torch.dtype) -> None:
    """The same supports, and numbers that differ by rounding of their own scale."""
    assert torch.equal(found.point_count, expected.point_count)
    assert found.point_count.dtype == torch.int64
    tolerance = _ROUNDINGS * torch.finfo(dtype).eps
    sizes = {"value": 1.0, "gradient": 1 / radius, "centroid_offset": radius, "covariance": 1 / radius**2}
    for name, size in sizes.items():
        one, other = getattr(found, name), getattr(expected, name)
        if other is None:
            assert one is None
            continue
        assert one.dtype == dtype
        torch.testing.assert_close(one.double(), other.double(), rtol=tolerance, atol=tolerance * size, equal_nan=True)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    ("batches", "components", "noise"),
    [
        ((1, 1, 1), 2, "shared"),
        ((1, 3, 1), 1, None),
        ((1, 3, 1), 2, "full"),
        ((3, 3, 3), 5, "shared"),
        ((3, 1, 1), 2, "full"),
        ((1, 1, 3), 3, None),
        ((0, 0, 0), 2, "shared"),
        ((1, 0, 1), 2, None),
    ],
)
def test_same_planes(
    instruction_set: int,
    portable: Portable,
    batches: tuple[int, int, int],
    components: int,
    noise: str | None,
    dtype: torch.dtype,
) -> None:
    points, values, queries = (
        random(batch, count, width, seed=seed)
        for seed, (batch, count, width) in enumerate(
            zip(batches, (301, 301, 83), (2, components, 2), strict=True), start=1
        )
    )
    points, queries = (10 * points).to(dtype), (12 * queries - 1).to(dtype)
    values = (values + 100).to(dtype)
    variance = None
    if noise == "shared":
        variance = random(batches[1], 301, seed=4).to(dtype)
    elif noise == "full":
        root = random(batches[1], 301, components, components, seed=4)
        variance = (root @ root.mT).to(dtype)
    exact = [None if tensor is None else tensor.double() for tensor in (points, values, queries, variance)]
    for gauge in (2.5, 40.0):
        found = local_gradients(points, values, queries, gauge_length=gauge, variance=variance)
        expected = portable(
            lambda gauge=gauge: local_gradients(*exact[:3], gauge_length=gauge, variance=exact[3])  # type: ignore[misc, arg-type]
        )
        assert_same(found, expected, gauge / 2, dtype)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_missing_numbers(instruction_set: int, portable: Portable, dtype: torch.dtype) -> None:
    """Points that are missing in some frames, in all, and never; queries that are missing."""
    points, values = (10 * random(1, 200, 2)).to(dtype), random(3, 200, 2, seed=2).to(dtype)
    variance, queries = random(3, 200, seed=3).to(dtype), (10 * random(1, 50, 2, seed=4)).to(dtype)
    points[0, 3, 1], points[0, 4, 0] = torch.nan, torch.inf
    values[1, 10:30, 0], values[2] = torch.nan, torch.nan
    variance[0, 50:60], variance[0, 60:70], variance[1, 70] = -1.0, torch.inf, torch.nan
    queries[0, 5, 0], queries[0, 6, 1] = torch.nan, -torch.inf

    def fit() -> LocalFit:
        return local_gradients(points, values, queries, gauge_length=3.0, variance=variance)

    found = fit()
    assert_same(found, portable(fit), 1.5, dtype)
    assert found.value[:2].isfinite().any()
    assert found.value[2].isnan().all()
    assert found.point_count[:, 5:7].eq(0).all()


def test_points_on_the_rim_are_outside(instruction_set: int, portable: Portable) -> None:
    """Whole numbers have exact distances: the same points count, in any order of the sums."""
    axis = torch.arange(40.0)
    points = torch.cartesian_prod(axis, axis)[None]
    values = random(1, len(points[0]), 2).float()

    def fit() -> LocalFit:
        return local_gradients(points, values, gauge_length=10.0)

    found = fit()
    assert torch.equal(found.point_count, portable(fit).point_count)
    inside = torch.cdist(points[0], points[0]).square().round() < 25
    assert torch.equal(found.point_count[0], inside.sum(1))


def test_points_and_queries_far_from_the_others(instruction_set: int, portable: Portable) -> None:
    """More than a hundredth of them, on both sides."""
    points, values, queries = (10 * random(1, 300, 2, seed=seed) for seed in (1, 2, 3))
    points[0, :2], points[0, 2:6] = 1e6, -1e5
    queries[0, :5], queries[0, 5] = 1e6 + 0.5, -1e5

    def fit(dtype: torch.dtype) -> LocalFit:
        return local_gradients(points.to(dtype), values.to(dtype), queries.to(dtype), gauge_length=3.0)

    assert_same(fit(torch.float64), portable(lambda: fit(torch.float64)), 1.5, torch.float64)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_any_unit_of_length(instruction_set: int, portable: Portable, scale: float) -> None:
    points, values = (10 * scale * random(1, 200, 2)).float(), random(1, 200, 2, seed=2).float()

    def fit(dtype: torch.dtype) -> LocalFit:
        return local_gradients(points.to(dtype), values.to(dtype), gauge_length=3 * scale)

    found = fit(torch.float32)
    assert found.gradient.isfinite().all(-1).float().mean() > 0.9
    assert_same(found, portable(lambda: fit(torch.float64)), 1.5 * scale, torch.float32)


def test_strided_and_shared_memory(instruction_set: int) -> None:
    points, values = random(1, 100, 4)[..., ::2], random(2, 3, 100).mT
    variance = random(1, 1).expand(2, 100)
    found = local_gradients(points, values, gauge_length=0.5, variance=variance)
    again = local_gradients(points.contiguous(), values.contiguous(), gauge_length=0.5, variance=variance.contiguous())
    for one, other in zip(found, again, strict=True):
        assert one is not None
        assert other is not None
        torch.testing.assert_close(one, other, rtol=0, atol=0, equal_nan=True)


@pytest.mark.parametrize(("points", "queries"), [(0, 5), (5, 0), (1, 1), (17, 33)])
def test_few_points(instruction_set: int, portable: Portable, points: int, queries: int) -> None:
    places, values, asked = random(1, points, 2), random(1, points, 2), random(1, queries, 2, seed=3)

    def fit() -> LocalFit:
        return local_gradients(places, values, asked, gauge_length=1.0, variance=values[..., 0])

    assert_same(fit(), portable(fit), 0.5, torch.float64)


def test_threads_change_nothing(instruction_set: int) -> None:
    points, values = random(1, 300, 2), random(4, 300, 2)
    before = torch.get_num_threads()
    results = []
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            results.append(local_gradients(points, values, gauge_length=0.4).gradient)
    finally:
        torch.set_num_threads(before)
    torch.testing.assert_close(*results, rtol=0, atol=0, equal_nan=True)


def test_what_does_not_belong_together_is_refused() -> None:
    places = random(1, 5, 2)

    def fit(points: Tensor, values: Tensor, queries: Tensor, noise: Tensor | None = None) -> object:
        return kernels.local_gradients(points, values, queries, noise, radius=1.0, least_spread=0.1, minimum_points=5)

    with pytest.raises(TypeError, match="values"):
        fit(places, places.float(), places)
    with pytest.raises(ValueError, match="points"):
        fit(places[..., :1], places, places)
    with pytest.raises(ValueError, match="noise"):
        fit(places, places, places, random(1, 5, 3))
    with pytest.raises(ValueError, match="batches"):
        fit(places.expand(2, 5, 2), places.expand(3, 5, 2), places)
