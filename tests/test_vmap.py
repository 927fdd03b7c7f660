"""Tests that `torch.func.vmap` of every public op gives the results of a loop over the mapped axis."""

import pytest
import torch
from torch import Tensor

from fingerflow import ops
from tests.embedded import CASES, scene, tensors_of

POINTS = scene(1)[2]

#: Without a variance `local_gradients` returns None for the covariance, which vmap refuses.
NOT_WHOLE = ("local_gradients",)
OF_OPS = [name for name in CASES if name.partition(" ")[0] in ops.__all__ and name not in NOT_WHOLE]


def pairs() -> tuple[Tensor, Tensor]:
    """Return two pairs of images (2, 1, 1, H, W), float32."""
    first, second = (torch.stack((one, one.roll(2, 3))).float() for one in scene(1)[:2])
    return first, second


def tracked(previous: Tensor, current: Tensor) -> Tensor:
    """Return the sum of the positions, whose derivative by the images is not 0."""
    return ops.track_points(previous, current, POINTS, window=11).points.nan_to_num().sum()


def flow(previous: Tensor, current: Tensor) -> Tensor:
    return ops.dense_flow(previous, current).displacement.nan_to_num().sum()


@pytest.mark.parametrize("name", OF_OPS)
def test_equals_a_loop(name: str) -> None:
    """vmap of an op agrees with a loop to rounding: the loop uses the compiled kernels, which sum in another order."""
    case = CASES[name]
    dims = tuple(0 if isinstance(one, Tensor) and one.dtype != torch.int64 else None for one in case.inputs)
    inputs = [
        one if dim is None else torch.stack((one, one.roll(1, 0))) for one, dim in zip(case.inputs, dims, strict=True)
    ]
    results = tensors_of(torch.func.vmap(case.call, in_dims=dims)(*inputs))
    rows = [
        tensors_of(case.call(*(one if dim is None else one[k] for one, dim in zip(inputs, dims, strict=True))))
        for k in range(2)
    ]
    assert results
    for result, *wanted in zip(results, *rows, strict=True):
        torch.testing.assert_close(result, torch.stack(wanted), rtol=1e-4, atol=1e-4, equal_nan=True)


def test_a_part_of_the_fit_is_mapped_where_the_whole_has_none() -> None:
    _, _, points, moved = scene(2)

    def gradient(values: Tensor) -> Tensor:
        return ops.local_gradients(points[:1], values, gauge_length=60.0).gradient

    wanted = ops.local_gradients(points[:1], moved, gauge_length=60.0).gradient
    found = torch.func.vmap(gradient)(moved[:, None])[:, 0]
    torch.testing.assert_close(found, wanted, rtol=1e-4, atol=1e-5, equal_nan=True)


def test_mapped_twice_and_along_another_axis_with_an_image_for_all() -> None:
    """Nested vmap along other axes, with one image for all, agrees with a loop; with one pass an optional result of the
    op is missing.
    """
    previous, current = pairs()
    wanted = [ops.track_points(previous[0], one, POINTS, window=11, passes=1).points for one in current]

    def one(image: Tensor) -> Tensor:
        return ops.track_points(previous[0], image, POINTS, window=11, passes=1).points

    found = torch.func.vmap(torch.func.vmap(one, in_dims=2), in_dims=1)(current.movedim(0, 2)[:, None])
    torch.testing.assert_close(found[0], torch.stack(wanted), rtol=0, atol=1e-4, equal_nan=True)


def test_derivative_inside_and_outside_the_map() -> None:
    """Derivatives inside and outside vmap are right, although vmap hides from an op that a derivative is wanted."""
    previous, current = pairs()
    wanted = torch.stack(
        [
            torch.autograd.grad(tracked(first, given), given)[0]
            for first, given in zip(previous, current.clone().requires_grad_(), strict=True)
        ]
    )
    assert wanted.abs().max() > 1e-4

    def total(images: Tensor) -> Tensor:
        return torch.func.vmap(tracked)(previous, images).sum()

    leaf = current.clone().requires_grad_()
    total(leaf).backward()
    inside = torch.func.vmap(torch.func.grad(tracked, argnums=1))(previous, current)
    for found in (leaf.grad, torch.func.grad(total)(current), inside):
        torch.testing.assert_close(found, wanted, rtol=1e-4, atol=1e-6)


def test_no_derivative_is_an_error_and_not_zero() -> None:
    previous, current = pairs()
    sentence = r"has no derivative under torch\.func\.vmap: pass a batch \(B, \.\.\.\) instead"
    with pytest.raises(RuntimeError, match=sentence):
        torch.func.grad(lambda images: torch.func.vmap(flow)(previous, images).sum())(current)
    with pytest.raises(RuntimeError, match=sentence):
        torch.func.vmap(torch.func.grad(flow))(previous, current)
