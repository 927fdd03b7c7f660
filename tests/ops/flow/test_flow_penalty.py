"""Tests of the Charbonnier penalty of dense flow: motion boundaries, and the equation that its fixed point solves."""

import torch
from torch import Tensor

from bench import skin
from bench.suites import flow
from fingerflow.ops import dense_flow
from tests.ops.flow.test_dense_flow import GREY, errors, grid, pair, photograph, wave

SHAPE = (192, 240)


def errors_by_penalty(first: Tensor, current: Tensor, truth: Tensor, warps: int = 2) -> list[Tensor]:
    """Return the errors (1, H, W) px of the quadratic and of the Charbonnier penalty."""
    return [
        errors(dense_flow(first, current, warps=warps, model=penalty).displacement, truth)
        for penalty in ("quadratic", "charbonnier")
    ]


def dust() -> tuple[Tensor, Tensor, Tensor]:
    """Return images of skin that moves by up to 1.6 px behind 45 specks of half the light, and the truth."""
    first, current, truth = flow.pair(GREY, SHAPE)
    x, y = grid(SHAPE)
    specks = torch.rand(45, 3, 1, 1, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    right, down, wide = specks.unbind(1)
    square = ((x - right * SHAPE[1]) ** 2 + (y - down * SHAPE[0]) ** 2) / (1.5 + 1.5 * wide) ** 2
    light = (1 - 0.5 * torch.exp(-square * square)).prod(0)
    return photograph(first * light), photograph(current * light), truth


def jump() -> tuple[Tensor, Tensor, Tensor]:
    """Return images of skin that sticks inside an ellipse and slips by 1.5 px outside, and the truth; NaN where skin
    is hidden behind the ellipse.
    """
    height, width = SHAPE
    x, y = grid(SHAPE)

    def is_stuck(x: Tensor) -> Tensor:
        return ((x - width / 2) / (0.3 * width)) ** 2 + ((y - height / 2) / (0.32 * height)) ** 2 < 1

    material = torch.where(is_stuck(x), x, x - 1.5)
    images = (skin.photograph(flow.ridges()(at, y)[None, None], 2.0, seed) for seed, at in enumerate((x, material)))
    along = torch.where(is_stuck(x), 0.0, torch.where(is_stuck(x + 1.5), torch.nan, 1.5))
    return *images, torch.stack((along, 0 * x))[None]


def test_dust_on_the_glass_counts_for_little() -> None:
    first, current, truth = dust()
    quadratic, robust = (one[..., 16:-16, 16:-16].nanmean() for one in errors_by_penalty(first, current, truth))
    assert robust < 0.55 * quadratic
    assert robust < 0.04


def test_a_jump_is_recognised_by_the_residual_it_leaves() -> None:
    """The default chooses the Charbonnier form at a jump of 1.5 px, with at most 0.6 of the error of the quadratic
    form, and keeps the quadratic form for skin that moves as a whole.
    """
    first, current, truth = jump()
    quadratic, edges, default = (dense_flow(first, current, model=model) for model in ("quadratic", "edges", "auto"))
    assert torch.equal(default.displacement.nan_to_num(), edges.displacement.nan_to_num())
    assert errors(edges.displacement, truth).nanmean() < 0.6 * errors(quadratic.displacement, truth).nanmean()
    smooth = tuple(map(photograph, pair(wave, noise=2.0)[:2]))
    kept = (dense_flow(*smooth, model=model).displacement.nan_to_num() for model in ("quadratic", "auto"))
    assert torch.equal(*kept)
