"""Tests of compiled dense flow against the portable form, with every instruction set."""

import itertools
import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.ops.flow.dense_flow import Flow, find_flow, prepare_flow
from fingerflow.ops.flow.flow_cells import to_pixels
from fingerflow.ops.flow.flow_constancy import Constancy
from fingerflow.ops.flow.flow_covariance import flow_covariance
from fingerflow.ops.flow.flow_multigrid import Level, descended, edges, pyramid
from fingerflow.ops.flow.flow_penalty import Penalty
from tests.ops.flow.test_dense_flow import CONSTANCIES, PENALTIES, grid, pair, wave

Portable = Callable[[Callable[[], Any]], Any]


@pytest.mark.parametrize("warm", [True, False])
@CONSTANCIES
@PENALTIES
def test_flow_where_little_is_known(
    instruction_set: int, portable: Portable, penalty: Penalty, constancy: Constancy, warm: bool
) -> None:
    """Both forms agree with a batch, a mask with an island and single pixels, pixels that are NaN or infinite, changed
    light and skin that leaves the picture, from a given flow and from none.

    Displacements agree to 1e-4 px, a hundredth of the effect of noise: sums are rounded otherwise, and every warp
    begins from the last. Covariance and residual after one warp agree to a thousandth.
    """
    shape = (67, 91)
    first, current, truth = (
        torch.cat(some) for some in zip(*(pair(wave, 2.0, seed, shape) for seed in (0, 1)), strict=True)
    )
    first, current = first.float(), 0.9 * current.float() + 5
    first[0, 0, 30, 40] = math.nan
    current[1, 0, 20:22, 50] = math.inf
    x, y = grid(shape)
    mask = (((x - 45) / 38) ** 2 + ((y - 30) / 24) ** 2 < 1) | ((x - 84).abs() + (y - 60).abs() < 4)
    mask[::13, ::17] = True
    initial = (0.8 * truth).float()
    initial[:, 1, :, :12] -= 6.0  # skin that leaves at the top
    initial[0, 0, 5:9, 5:9] = math.nan

    def found() -> Flow:
        noise = torch.tensor([2.0, 2.0])
        template = prepare_flow(first, mask.expand(2, 1, -1, -1), noise=noise, constancy=constancy)
        return find_flow(template, current, initial if warm else None, warps=1 if warm else 2, penalty=penalty)

    compiled, expected = found(), portable(found)
    assert compiled.displacement.isfinite().any()
    assert compiled.displacement.isnan().any()
    torch.testing.assert_close(compiled.displacement, expected.displacement, rtol=0, atol=1e-4, equal_nan=True)
    for one, other in zip(compiled[1:], expected[1:], strict=True):
        torch.testing.assert_close(one, other, rtol=1e-3, atol=1e-6, equal_nan=True)


def system(height: int, width: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return J, the edges to the right and down, and a mask with holes: a batch of two with different smoothing and
    structure tensors from none to far above noise.
    """
    generator = torch.Generator().manual_seed(height)
    mask = (torch.rand(2, 1, height, width, generator=generator) > 0.1).float()
    size = torch.rand(2, 1, height, width, generator=generator) ** 8
    slopes = 30 * size * torch.randn(2, 2, height, width, generator=generator)
    slopes[..., : width // 3] = 0
    tensor = torch.cat((slopes[:, :1] ** 2 + size, slopes[:, :1] * slopes[:, 1:], slopes[:, 1:] ** 2 + size), 1) * mask
    alpha = torch.tensor([400.0, 30.0]).view(2, 1, 1, 1)
    right, down = (alpha * edge for edge in edges(mask))
    return tensor, right, down, mask


SIZES = pytest.mark.parametrize(("height", "width"), [(5, 9), (37, 53), (64, 80), (120, 33), (8, 1000)])


@SIZES
def test_cycles(instruction_set: int, portable: Portable, height: int, width: int) -> None:
    """Multigrid cycles agree to the rounding of float32 where little of the flow is known."""
    levels, random = pyramid(*system(height, width)), torch.Generator().manual_seed(1)
    pull, flow = (torch.randn(2, 2, height, width, generator=random) * levels[0].inside for _ in range(2))
    known = (torch.rand(2, 1, height, width, generator=random) > 0.5).float() * levels[0].inside

    def solved() -> Tensor:
        return descended(levels, pull, flow, known, 2)

    compiled, expected = solved(), portable(solved)
    torch.testing.assert_close(compiled, expected, rtol=0, atol=5e-6 * float(expected.abs().max()))


@SIZES
def test_preparation(instruction_set: int, portable: Portable, height: int, width: int) -> None:
    """Levels agree to a few roundings of float32, cells at pixels to rounding, and covariances to 1e-4 of the largest.

    Determinants of the inverses cancel. The smaller eigenvalue l of ridges in one direction is a difference of nearly
    equal numbers, and l ln l, on which the covariance depends, is steep at 0.
    """
    tensor, right, down, mask = system(height, width)
    variance, alpha = torch.tensor([4.0, 0.2]), torch.tensor([400.0, 30.0]).view(2, 1, 1, 1)
    field = torch.randn(2, 2, height, width, generator=torch.Generator().manual_seed(1))

    def made() -> tuple[list[Level], Tensor, Tensor]:
        spread = flow_covariance(tensor, variance, alpha, 30.0, variance / 20)
        return pyramid(tensor, right, down, mask), spread, to_pixels(field, mask, 2 * height - 1, 2 * width)

    (levels, spread, pixels), (expected_levels, expected_spread, expected_pixels) = made(), portable(made)
    for level, expected in itertools.zip_longest(levels, expected_levels):
        for name, one, other in zip(level._fields, level, expected, strict=True):
            most_off = 1.5e-6 if name == "inverse" else 5e-7
            torch.testing.assert_close(one, other, rtol=most_off, atol=most_off * float(other.abs().max()))
    assert expected_spread.isnan().any()
    assert expected_spread.isfinite().any()
    largest = float(expected_spread.nan_to_num().abs().max())
    torch.testing.assert_close(spread, expected_spread, rtol=0, atol=1e-4 * largest, equal_nan=True)
    torch.testing.assert_close(pixels, expected_pixels, rtol=0, atol=5e-6)


@pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")
@pytest.mark.parametrize("weights", [[], [0.5, 0.5], [0.2, 0.5, 0.3]])
def test_weights_without_a_middle_are_refused(weights: list[float]) -> None:
    with pytest.raises(ValueError, match="give an odd number"):
        kernels.flow_integrate(torch.ones(1, 1, 8, 8), weights)
