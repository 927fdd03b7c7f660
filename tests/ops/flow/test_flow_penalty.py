"""Tests of the Charbonnier penalty of dense flow: motion boundaries, and the equation that its fixed point solves."""

import math

import pytest
import torch
from torch import Tensor

from bench.suites.flow_outliers import dust, jump
from fingerflow.kernels.flow import FlowResidual
from fingerflow.ops import dense_flow
from fingerflow.ops.flow.flow_penalty import data_weights, edge_weights
from tests.ops.flow.test_dense_flow import GREY, errors, pair, photograph, wave

SHAPE = (192, 240)


def errors_by_penalty(first: Tensor, current: Tensor, truth: Tensor, warps: int = 2) -> list[Tensor]:
    """Return the errors (1, H, W) px of the quadratic and of the Charbonnier penalty."""
    return [
        errors(dense_flow(first, current, warps=warps, model=penalty).displacement, truth)
        for penalty in ("quadratic", "charbonnier")
    ]


@pytest.mark.parametrize(("slip", "share"), [(0.5, 0.85), (1.5, 0.75)])
def test_a_jump_of_motion_stays_one(slip: float, share: float) -> None:
    """A jump of the motion is found with a smaller error than by the quadratic form, both within 5 px of the jump and
    beyond, where windows of 17 px still cross it.
    """
    first, current, truth, edge = jump(SHAPE, slip)
    quadratic, robust = (one[0] for one in errors_by_penalty(first, current, truth, warps=5))
    for where in (edge, ~edge):
        assert robust[where].nanmean() < share * quadratic[where].nanmean()
    assert robust[8:-8, 8:-8][~edge[8:-8, 8:-8]].nanmean() < 0.05


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


def test_weights_of_the_smoothing() -> None:
    """Weights are 1 / sqrt(1 + (|grad d| / (0.1 roughness))^2) with cells 2 px apart; both components share one weight
    per edge.
    """
    departure = torch.zeros(1, 2, 3, 4, dtype=torch.float64)
    departure[:, 0, :, 2:] = 0.03
    departure[:, 1, :, 2:] = -0.04
    right, down = edge_weights(departure, roughness=0.25)
    assert (down == 1).all()
    assert (right[..., [0, 2]] == 1).all()
    torch.testing.assert_close(right[..., 1], torch.full((1, 1, 3), 1 / math.sqrt(2), dtype=torch.float64))


def test_weights_of_the_data() -> None:
    """Weights are 1 at the residual expected from noise (0.42 of its deviation), inverse to large residuals, and finite
    where no pixel is seen.
    """
    noise = 3.0
    expected = (0.42 * noise) ** 2
    squares = torch.tensor([1.0, 25.0, 1e8, 0.0], dtype=torch.float64).view(1, 1, 1, 4) * expected
    seen = torch.tensor([1.0, 1.0, 1.0, 0.0], dtype=torch.float64).view(1, 1, 1, 4)
    left = FlowResidual(squares, squares, seen, torch.ones(1, 1, 1, 1, dtype=torch.float64))
    weights = data_weights(left, torch.tensor([expected], dtype=torch.float64)).flatten()
    assert weights[0] == pytest.approx(1)
    assert weights[1] == pytest.approx(math.sqrt(5 / 29))
    assert weights[2] == pytest.approx(math.sqrt(5) / 1e4, rel=1e-6)
    assert weights[3].isfinite()
