"""Tests of the multigrid solver of dense flow against a direct solver."""

import pytest
import torch
from torch import Tensor

from fingerflow.ops.flow.flow_multigrid import applied, descended, edges, pyramid


def system(height: int, width: int, masked: bool, seed: int = 0) -> tuple[list, Tensor, Tensor]:
    """Return the levels, a right-hand side (1, 2, H, W) and the mask (1, 1, H, W) of an image with texture and a blank
    part.
    """
    generator = torch.Generator().manual_seed(seed)
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    mask = torch.ones(1, 1, height, width, dtype=torch.float64)
    if masked:
        mask[0, 0] = ((x - width / 2) / (0.45 * width)) ** 2 + ((y - height / 2) / (0.4 * height)) ** 2 < 1
    slopes = 5 * torch.randn(1, 2, height, width, generator=generator, dtype=torch.float64)
    slopes[..., : width // 3] = 0
    tensor = torch.cat((slopes[:, :1] ** 2, slopes[:, :1] * slopes[:, 1:], slopes[:, 1:] ** 2), dim=1) * mask
    right_side = mask * torch.randn(1, 2, height, width, generator=generator, dtype=torch.float64)
    return pyramid(tensor, *(40.0 * edge for edge in edges(mask)), mask), right_side, mask


def solve(levels: list, right_side: Tensor, cycles: int) -> Tensor:
    """Return the solution after some cycles from 0, where each cycle solves for the remaining residual."""
    return descended(levels, right_side, torch.zeros_like(right_side), torch.zeros_like(right_side[:, :1]), cycles)


@pytest.mark.parametrize(("height", "width", "masked"), [(16, 24, False), (17, 23, False), (21, 18, True)])
def test_cycles_end_at_the_direct_solution(height: int, width: int, masked: bool) -> None:
    levels, right_side, mask = system(height, width, masked)
    basis = torch.eye(2 * height * width, dtype=torch.float64).view(-1, 2, height, width)
    matrix = applied(levels[0], basis).flatten(1).T
    torch.testing.assert_close(matrix, matrix.T)
    known = mask.expand(1, 2, height, width).flatten() > 0
    direct = torch.zeros_like(right_side).flatten()
    direct[known] = torch.linalg.solve(matrix[known][:, known], right_side.flatten()[known])
    found = solve(levels, right_side, 30)
    torch.testing.assert_close(found.flatten(), direct, rtol=0, atol=1e-9 * float(direct.abs().max()))
    assert (found.flatten()[~known] == 0).all()


@pytest.mark.parametrize("masked", [False, True])
def test_a_cycle_leaves_a_quarter_of_the_residual_at_any_size(masked: bool) -> None:
    """A cycle leaves at most a quarter of the residual (mean of five cycles), whatever the number of pixels."""
    rates = []
    for height, width in ((32, 40), (61, 83), (128, 160)):
        levels, right_side, _ = system(height, width, masked)
        found = solve(levels, right_side, 5)
        left = right_side - applied(levels[0], found)
        rates.append(float(left.norm() / right_side.norm()) ** 0.2)
    assert max(rates) < 0.25
