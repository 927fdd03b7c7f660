"""Dense flow by the gradient of grey levels: light that differs from place to place, and what its noise leaves."""

import pytest
import torch
from torch import Tensor

from fingerflow.kernels.tracking_limits import GRADIENT_NOISE
from fingerflow.ops import dense_flow
from fingerflow.ops.filters.spline import spline_coefficients
from fingerflow.ops.flow.dense_flow import _fields
from fingerflow.ops.flow.flow_constancy import LEFT_BY_NOISE, NOISE_OF_TENSOR, Constancy, channels
from tests.ops.flow.test_dense_flow import CONSTANCIES, errors, grid, pair, photograph, wave


@CONSTANCIES
def test_what_noise_leaves(constancy: Constancy) -> None:
    """The constants, from white noise of deviation 1 itself: 360,000 px give its variance to 0.5 %."""
    noise = torch.randn(1, 1, 600, 600, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    given = channels(spline_coefficients(noise), constancy)
    fields = _fields(given, torch.ones_like(given))
    inner = (..., slice(8, -8), slice(8, -8))
    left = (2 * fields.value[inner].square().mean((1, 2, 3)).sum()).sqrt()
    assert float(left) == pytest.approx(LEFT_BY_NOISE[constancy], rel=0.02)
    trace = fields.tensor[:, [0, 2]][inner].mean((2, 3)).sum() / 2
    assert float(trace) == pytest.approx(NOISE_OF_TENSOR[constancy] * GRADIENT_NOISE, rel=0.05)


def uneven(image: Tensor) -> Tensor:
    """Light that rises and falls by a fifth over 100 px each way."""
    x, y = grid((image.shape[-2], image.shape[-1]))
    return image * (1 + 0.2 * torch.sin(x / 17) * torch.cos(y / 16))


def errors_by_constancy(first: Tensor, current: Tensor, truth: Tensor) -> list[float]:
    """Mean errors of constant brightness and of constant gradient, px."""
    return [
        float(errors(dense_flow(first, current, constancy=constancy).displacement, truth, 16).nanmean())
        for constancy in ("brightness", "gradient")
    ]


def test_light_that_changes_from_place_to_place() -> None:
    first, current, truth = pair(wave, noise=2.0)
    brightness, gradient = errors_by_constancy(photograph(first), photograph(uneven(current)), truth)
    assert gradient < 0.5 * brightness
    assert gradient < 0.03


def test_steady_light_costs_a_fifth() -> None:
    """Noise of short waves counts for more."""
    brightness, gradient = errors_by_constancy(*(one.float() for one in pair(wave, noise=2.0)))
    assert gradient < 1.3 * brightness
