"""The multigrid of dense flow beside a direct solver."""

import pytest
import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.ops.flow.flow_cells import to_pixels
from fingerflow.ops.flow.flow_covariance import flow_covariance
from fingerflow.ops.flow.flow_descent import descended
from fingerflow.ops.flow.flow_multigrid import applied, edges, pyramid


def system(height: int, width: int, masked: bool, seed: int = 0) -> tuple[list, Tensor, Tensor]:
    """Levels, a right side, and the mask, of texture with a blank part."""
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
    """From 0: where nothing is known there is no course, and every cycle goes on with what is left over."""
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
    """Per cycle, over five: it does not grow with the number of pixels, which is what multigrid is for."""
    rates = []
    for height, width in ((32, 40), (61, 83), (128, 160)):
        levels, right_side, _ = system(height, width, masked)
        found = solve(levels, right_side, 5)
        left = right_side - applied(levels[0], found)
        rates.append(float(left.norm() / right_side.norm()) ** 0.2)
    assert max(rates) < 0.25


def test_a_constant_has_no_laplacian() -> None:
    levels, _, mask = system(19, 22, True)
    for level in levels:
        constant = torch.full((1, 2, *level.inside.shape[-2:]), 3.0, dtype=torch.float64)
        torch.testing.assert_close(
            applied(level, constant) - applied(level._replace(right=0 * level.right, down=0 * level.down), constant),
            torch.zeros_like(constant),
        )
    assert mask.sum() < mask.numel()


@pytest.mark.skipif(not kernels.serve(), reason="no compiled kernels here")
@pytest.mark.parametrize("most", [0, 1, 2])
@pytest.mark.parametrize(("height", "width"), [(5, 9), (37, 53), (64, 80), (120, 33), (8, 1000)])
def test_compiled_cycles_are_the_portable_ones(
    height: int, width: int, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the rounding of float32, in every instruction set, over a mask with holes, for a batch."""
    generator = torch.Generator().manual_seed(height)
    mask = (torch.rand(2, 1, height, width, generator=generator) > 0.1).float()
    slopes = 5 * torch.randn(2, 2, height, width, generator=generator)
    tensor = torch.cat((slopes[:, :1] ** 2, slopes[:, :1] * slopes[:, 1:], slopes[:, 1:] ** 2), dim=1) * mask
    alpha = torch.tensor([40.0, 3.0]).view(2, 1, 1, 1)
    levels = pyramid(tensor, *(alpha * edge for edge in edges(mask)), mask)
    right_side = torch.randn(2, 2, height, width, generator=generator) * mask
    kernels.limit_instruction_set(most)
    try:
        compiled = solve(levels, right_side, 2)
    finally:
        kernels.limit_instruction_set(-1)
    monkeypatch.setattr(kernels, "serve", lambda *_: False)
    portable = solve(levels, right_side, 2)
    torch.testing.assert_close(compiled, portable, rtol=0, atol=5e-6 * float(portable.abs().max()))


@pytest.mark.skipif(not kernels.serve(), reason="no compiled kernels here")
@pytest.mark.parametrize("most", [0, 1, 2])
@pytest.mark.parametrize(("height", "width"), [(5, 9), (37, 53), (64, 80), (33, 120)])
def test_compiled_preparation_is_the_portable_one(
    height: int, width: int, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Levels to some roundings of float32 (determinants of inverses cancel), cells at pixels to rounding, covariance
    to 1e-4 of the largest: the smaller eigenvalue l of ridges in one direction is a difference of equal numbers, and
    l ln l, on which it depends, is steep at 0. For a batch with different noise, tensors from none to far above it, and
    holes in the mask."""
    generator = torch.Generator().manual_seed(height)
    mask = (torch.rand(2, 1, height, width, generator=generator) > 0.1).float()
    size = torch.rand(2, 1, height, width, generator=generator) ** 8
    slopes = 30 * size * torch.randn(2, 2, height, width, generator=generator)
    slopes[..., : width // 3] = 0
    tensor = torch.cat((slopes[:, :1] ** 2 + size, slopes[:, :1] * slopes[:, 1:], slopes[:, 1:] ** 2 + size), 1) * mask
    alpha, variance = torch.tensor([400.0, 30.0]).view(2, 1, 1, 1), torch.tensor([4.0, 0.2])
    right, down = (alpha * edge for edge in edges(mask))
    field = torch.randn(2, 2, height, width, generator=generator)

    def made() -> tuple[list, Tensor, Tensor]:
        spread = flow_covariance(tensor, variance, alpha, 30.0, variance / 20)
        return pyramid(tensor, right, down, mask), spread, to_pixels(field, mask, 2 * height - 1, 2 * width)

    kernels.limit_instruction_set(most)
    try:
        levels, spread, pixels = made()
    finally:
        kernels.limit_instruction_set(-1)
    monkeypatch.setattr(kernels, "serve", lambda *_: False)
    expected_levels, expected_spread, expected_pixels = made()
    assert len(levels) == len(expected_levels)
    for level, expected in zip(levels, expected_levels, strict=True):
        for name, one, other in zip(level._fields, level, expected, strict=True):
            most_off = 1.5e-6 if name == "inverse" else 5e-7
            torch.testing.assert_close(one, other, rtol=most_off, atol=most_off * float(other.abs().max()))
    assert expected_spread.isnan().any()
    assert expected_spread.isfinite().any()
    largest = float(expected_spread.nan_to_num().abs().max())
    torch.testing.assert_close(spread, expected_spread, rtol=0, atol=1e-4 * largest, equal_nan=True)
    torch.testing.assert_close(pixels, expected_pixels, rtol=0, atol=5e-6)
