"""Tests of the Charbonnier penalty of dense flow: motion boundaries, and the equation that its fixed point solves."""

import torch
from torch import Tensor

from bench.suites.flow_outliers import dust, jump
from fingerflow.ops import dense_flow
from tests.ops.flow.test_dense_flow import GREY, errors, pair, photograph, wave

SHAPE = (192, 240)


def errors_by_penalty(first: Tensor, current: Tensor, truth: Tensor, warps: int = 2) -> list[Tensor]:
    """Return the errors (1, H, W) px of the quadratic and of the Charbonnier penalty."""
    return [
        errors(dense_flow(first, current, warps=warps, model=penalty).displacement, truth)
        for penalty in ("quadratic", "charbonnier")
    ]


def test_dust_on_the_glass_counts_for_little() -> None:
    first, current, truth, _ = dust(SHAPE, GREY, 45)
    quadratic, robust = (one[..., 16:-16, 16:-16].nanmean() for one in errors_by_penalty(first, current, truth))
    assert robust < 0.55 * quadratic
    assert robust < 0.04


def test_a_jump_is_recognised_by_the_residual_it_leaves() -> None:
    """The default chooses the Charbonnier form at a jump of 1.5 px, with at most 0.6 of the error of the quadratic
    form, and keeps the quadratic form for skin that moves as a whole.
    """
    first, current, truth, _ = jump(SHAPE, 1.5)
    quadratic, edges, default = (dense_flow(first, current, model=model) for model in ("quadratic", "edges", "auto"))
    assert torch.equal(default.displacement.nan_to_num(), edges.displacement.nan_to_num())
    assert errors(edges.displacement, truth).nanmean() < 0.6 * errors(quadratic.displacement, truth).nanmean()
    smooth = tuple(map(photograph, pair(wave, noise=2.0)[:2]))
    kept = (dense_flow(*smooth, model=model).displacement.nan_to_num() for model in ("quadratic", "auto"))
    assert torch.equal(*kept)
