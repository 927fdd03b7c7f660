"""Dense flow by the gradient of grey levels: light that differs from place to place, and what its noise leaves."""

import pytest
import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.tracking_limits import GRADIENT_NOISE
from fingerflow.ops import dense_flow
from fingerflow.ops.filters.spline import spline_coefficients
from fingerflow.ops.flow.dense_flow import _fields, find_flow, prepare_flow
from fingerflow.ops.flow.flow_constancy import LEFT_BY_NOISE, NOISE_OF_TENSOR, Constancy, channels
from tests.ops.flow.test_dense_flow import PENALTIES, Penalty, errors, grid, pair, photograph, wave, with_few_sweeps


@pytest.mark.parametrize("constancy", ["brightness", "gradient"])
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


def test_light_that_changes_from_place_to_place() -> None:
    first, current, truth = pair(wave, noise=2.0)
    images = photograph(first), photograph(uneven(current))
    brightness, gradient = (
        float(errors(dense_flow(*images, constancy=constancy).displacement, truth, 16).nanmean())
        for constancy in ("brightness", "gradient")
    )
    assert gradient < 0.5 * brightness
    assert gradient < 0.03


def test_steady_light_costs_a_fifth() -> None:
    """Noise of short waves counts for more."""
    first, current, truth = (one.float() for one in pair(wave, noise=2.0))
    brightness, gradient = (
        float(errors(dense_flow(first, current, constancy=constancy).displacement, truth, 16).nanmean())
        for constancy in ("brightness", "gradient")
    )
    assert gradient < 1.3 * brightness


def test_no_motion_is_exactly_zero() -> None:
    image = photograph(pair(wave, 2.0)[0])
    assert (dense_flow(image, image, constancy="gradient").displacement == 0).all()


def test_another_constancy_is_named() -> None:
    image = torch.zeros(1, 1, 40, 40)
    with pytest.raises(ValueError, match=r"constancy must be one of .*'gradient'.*, not 'colour'"):
        dense_flow(image, image, constancy="colour")


@pytest.mark.skipif(not kernels.serve(), reason="no compiled kernels here")
@PENALTIES
def test_compiled_and_portable_flow_are_one(penalty: Penalty, monkeypatch: pytest.MonkeyPatch) -> None:
    """A batch of two, of which pixels are not finite: 1e-4 px, as with grey levels."""
    shape = (66, 91)
    firsts, currents, _ = (
        torch.cat(some).float() for some in zip(*(pair(wave, 2.0, seed, shape) for seed in (0, 1)), strict=True)
    )
    firsts[0, 0, 30, 40] = torch.nan
    currents[1, 0, 20:22, 50] = torch.inf

    def found() -> Tensor:
        return dense_flow(firsts, currents, penalty=penalty, constancy="gradient").displacement

    compiled = found()
    monkeypatch.setattr(kernels, "serve", lambda *_: False)
    torch.testing.assert_close(compiled, found(), rtol=0, atol=1e-4, equal_nan=True)
    assert compiled.isfinite().all(1).double().mean() > 0.9


def test_the_portable_form_is_exported(monkeypatch: pytest.MonkeyPatch) -> None:
    with_few_sweeps(monkeypatch)
    first, current, truth = pair(wave, noise=2.0, shape=(9, 12))
    template = prepare_flow(photograph(first), constancy="gradient")

    class Found(torch.nn.Module):
        def forward(self, current: Tensor, initial: Tensor) -> tuple[Tensor, ...]:
            return tuple(find_flow(template, current, initial, warps=1, penalty="charbonnier"))

    given = photograph(current), 0.8 * truth.float()
    exported = torch.export.export(Found(), given).module()(*given)
    for one, other in zip(exported, Found()(*given), strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=1e-4, equal_nan=True)
