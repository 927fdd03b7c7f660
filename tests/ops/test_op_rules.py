"""Tests of rules that hold for all ops: half precision is the rounded result of float32, empty batches pass, and
derivatives are those of finite differences.
"""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from fingerflow import ops
from fingerflow.ops.contact.otsu import histogram
from fingerflow.ops.contact.real_contact_mask import real_contact_mask
from fingerflow.ops.fields.area_medians import area_medians
from fingerflow.ops.fields.rigid_motion import rigid_residual
from fingerflow.ops.fields.strain import principal_strains, shear
from fingerflow.ops.tracking.corners import corner_response
from fingerflow.ops.tracking.outliers import find_neighbours, find_outliers
from tests.embedded import tensors_of

FRAMES, POINTS = torch.rand(2, 1, 24, 30), torch.rand(2, 8, 2)
TRIANGLES, NODES = torch.tensor([[0, 1, 2], [2, 3, 4]]), torch.linspace(0, 1, 3)
NONE_2 = torch.zeros(0, 2)
EMPTY: dict[str, Callable[[], Any]] = {
    "area_medians": lambda: area_medians(POINTS[:1], POINTS[:0], NONE_2, NONE_2, torch.zeros(0), gauge_length=1.0),
    "detect_corners": lambda: ops.detect_corners(FRAMES[:0], 7),
    "find_outliers": lambda: find_outliers(find_neighbours(POINTS[:1], 1.0), POINTS[:0], POINTS[:0, :, 0]),
    "helmholtz_hodge": lambda: ops.helmholtz_hodge(FRAMES[:0].expand(-1, 2, -1, -1)),
    "histogram": lambda: histogram(FRAMES[:0], value_range=(0, 1)),
    "local_gradients": lambda: ops.local_gradients(POINTS[:0], POINTS[:0], gauge_length=1.0),
    "median_filter": lambda: ops.median_filter(FRAMES[:0], 5),
    "normalize_illumination": lambda: ops.normalize_illumination(FRAMES[:0], FRAMES[:1]),
    "otsu_threshold": lambda: ops.otsu_threshold(FRAMES[:0], value_range=(0, 1)),
    "real_contact_mask": lambda: real_contact_mask(FRAMES[:0], FRAMES[:1], 0 * FRAMES[:1], torch.zeros(0)),
    "scattered_to_grid": lambda: ops.scattered_to_grid(POINTS[:0], POINTS[:0], NODES, NODES, 1.0),
    "strain": lambda: principal_strains(ops.green_lagrange(torch.zeros(0, 5, 2, 2))),
    "track_points": lambda: ops.track_points(FRAMES[:0], FRAMES[:0], POINTS[:0]),
    "triangle_gradients": lambda: ops.triangle_gradients(POINTS[:0], TRIANGLES, POINTS[:0]),
}
NONE: dict[str, tuple[Callable[[], Tensor], tuple[int, ...]]] = {
    "corners": (lambda: ops.detect_corners(FRAMES, 0).points, (2, 0, 2)),
    "queries": (lambda: ops.local_gradients(POINTS, POINTS, POINTS[:, :0], gauge_length=1.0).value, (2, 0, 2)),
    "points of a fit": (lambda: ops.local_gradients(POINTS[:, :0], POINTS[:, :0], gauge_length=1.0).value, (2, 0, 2)),
    "points tracked": (lambda: ops.track_points(FRAMES, FRAMES, POINTS[:, :0]).points, (2, 0, 2)),
    "triangles": (lambda: ops.triangle_gradients(POINTS, TRIANGLES[:0], POINTS), (2, 0, 2, 2)),
    "rows": (lambda: ops.median_filter(FRAMES[..., :0, :]), (2, 1, 0, 30)),
}


def of_gradients(op: Callable[[Tensor], Tensor]) -> Callable[[Tensor, Tensor], Tensor]:
    return lambda points, _: op(0.1 * points.reshape(2, 4, 2, 2))


ROUNDED: dict[str, tuple[Callable[[Tensor, Tensor], Tensor], float]] = {
    "local_gradients": (lambda points, values: ops.local_gradients(points, values, gauge_length=1.0).gradient, 0.0),
    "triangle_gradients": (lambda points, values: ops.triangle_gradients(points, TRIANGLES, values), 0.0),
    "median_filter": (lambda points, _: ops.median_filter(points[:, None], 3), 0.0),
    **{op.__name__: (of_gradients(op), 4.0) for op in (ops.divergence, ops.curl, shear, ops.green_lagrange)},
}


@pytest.mark.parametrize("name", EMPTY)
def test_a_batch_of_no_frames_gives_no_results(name: str) -> None:
    for result in tensors_of(EMPTY[name]()):
        assert len(result) == 0


@pytest.mark.parametrize("name", NONE)
def test_nothing_asked_gives_nothing(name: str) -> None:
    call, shape = NONE[name]
    assert call().shape == shape


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
@pytest.mark.parametrize("name", ROUNDED)
def test_half_precision_is_the_rounded_float32_result(name: str, dtype: torch.dtype) -> None:
    """Results equal the rounded ones of float32 where sums are taken in float32, else to a few roundings."""
    op, roundings = ROUNDED[name]
    points, values = (3 * one.to(dtype) for one in (POINTS, POINTS.flip(1)))
    found = op(points, values)
    assert found.dtype == dtype
    expected = op(points.float(), values.float())
    limit = roundings * torch.finfo(dtype).eps
    torch.testing.assert_close(found, expected.to(dtype), rtol=limit, atol=limit, equal_nan=True)


def of_fit(points: Tensor, values: Tensor, queries: Tensor, variance: Tensor) -> tuple[Tensor, ...]:
    fit = ops.local_gradients(points, values, queries, gauge_length=3.0, variance=variance.square() + 0.1)
    assert fit.covariance is not None
    return fit.value, fit.gradient, fit.covariance


def of_strain(gradient: Tensor) -> tuple[Tensor, ...]:
    strain = ops.green_lagrange(gradient)
    return ops.divergence(gradient), ops.curl(gradient), *principal_strains(strain), ops.strain_energy_density(strain)


IMAGE, PLACES, VECTORS = (1, 1, 6, 7), (2, 8, 2), (2, 8, 2)
LIGHT = FRAMES[:1, :, :6, :7].double()
#: Function of tensors of random numbers of these shapes.
DIFFERENTIABLE: dict[str, tuple[Callable[..., Any], tuple[tuple[int, ...], ...]]] = {
    "corner_response": (lambda frame: corner_response(frame, 3), (IMAGE,)),
    "helmholtz_hodge": (lambda field: ops.helmholtz_hodge(field).irrotational, ((1, 2, 6, 7),)),
    "local_gradients": (of_fit, (PLACES, VECTORS, (2, 3, 2), (2, 8))),
    "local_gradients at its points": (
        lambda *given: ops.local_gradients(*given, gauge_length=3.0)[:2],
        ((1, 8, 2), VECTORS),
    ),
    "median_filter": (lambda frame: ops.median_filter(frame, 3), (IMAGE,)),
    "normalize_illumination": (
        lambda frame: ops.normalize_illumination(frame, 2 * FRAMES[:1, :, :6, :7].double()).frames,
        (IMAGE,),
    ),
    "rigid_residual": (rigid_residual, (PLACES, VECTORS, (2, 8))),
    "strain": (of_strain, ((5, 2, 2),)),
    "triangle_gradients": (lambda points, values: ops.triangle_gradients(points, TRIANGLES, values), (PLACES, VECTORS)),
}


@pytest.mark.parametrize("name", DIFFERENTIABLE)
def test_derivatives(name: str) -> None:
    op, shapes = DIFFERENTIABLE[name]
    draw = torch.Generator().manual_seed(3)
    given = [torch.rand(shape, generator=draw, dtype=torch.float64).requires_grad_() for shape in shapes]
    assert torch.autograd.gradcheck(op, given)


@pytest.mark.parametrize("op", [lambda *given: ops.local_gradients(*given, gauge_length=1.0).gradient,
                                lambda points, values: ops.triangle_gradients(points, TRIANGLES, values)])  # fmt: skip
def test_derivatives_are_finite_beside_missing_points(op: Callable[[Tensor, Tensor], Tensor]) -> None:
    points, values = (torch.rand(PLACES, generator=torch.Generator().manual_seed(k)).double() for k in range(2))
    points[0, 0], points[1, 1], values[1, 2] = torch.nan, 100.0, torch.nan
    op(points.requires_grad_(), values.requires_grad_()).nansum().backward()
    for tensor in (points, values):
        assert tensor.grad is not None
        assert tensor.grad.isfinite().all()
        assert tensor.grad.abs().sum() > 0
