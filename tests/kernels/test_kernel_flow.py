"""Tests of compiled dense flow against the portable form, with every instruction set."""

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from fingerflow.ops.flow.dense_flow import Flow, find_flow, prepare_flow
from fingerflow.ops.flow.flow_constancy import Constancy
from fingerflow.ops.flow.flow_multigrid import descended, edges, pyramid
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
    right, down = (torch.tensor([400.0, 30.0]).view(2, 1, 1, 1) * edge for edge in edges(mask))
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
