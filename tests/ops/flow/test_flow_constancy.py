"""Tests of dense flow by grey levels and their gradient: light that varies over the image, and residuals
due to noise.
"""

import pytest
import torch
from torch import Tensor

from fingerflow.kernels.tracking_limits import GRADIENT_NOISE
from fingerflow.ops import dense_flow
from fingerflow.ops.filters.spline import spline_coefficients
from fingerflow.ops.flow.dense_flow import _fields
from fingerflow.ops.flow.flow_constancy import LEFT_BY_NOISE, NOISE_OF_TENSOR, Constancy, channels
from fingerflow.ops.flow.flow_penalty import FlowModel
from tests.ops.flow.test_dense_flow import CONSTANCIES, errors, grid, pair, photograph, wave

MODELS: tuple[FlowModel, ...] = ("quadratic", "edges", "auto")


@CONSTANCIES
def test_what_noise_leaves(constancy: Constancy) -> None:
    """The constants agree with the residual and the tensor of white noise of deviation 1, whose variance 360,000 px
    give to 0.5 %.
    """
    noise = torch.randn(1, 1, 600, 600, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    given = channels(spline_coefficients(noise), constancy)
    fields = _fields(given, torch.ones_like(given))
    inner = (..., slice(8, -8), slice(8, -8))
    left = (2 * fields.value[inner].square().mean((1, 2, 3)).sum()).sqrt()
    assert float(left) == pytest.approx(LEFT_BY_NOISE[constancy], rel=0.02)
    trace = fields.tensor[:, [0, 2]][inner].mean((2, 3)).sum() / 2
    assert float(trace) == pytest.approx(NOISE_OF_TENSOR[constancy] * GRADIENT_NOISE, rel=0.05)


def uneven(image: Tensor) -> Tensor:
    """Return an image whose light rises and falls by a fifth over about 100 px in x and y."""
    x, y = grid((image.shape[-2], image.shape[-1]))
    return image * (1 + 0.2 * torch.sin(x / 17) * torch.cos(y / 16))


def test_light_that_changes_from_place_to_place_is_no_motion_boundary() -> None:
    """Light that varies over the image is not taken for a motion boundary: neither model explains the residual, and the
    default keeps the quadratic form.
    """
    first, current, truth = pair(wave, noise=2.0)
    images = photograph(first), photograph(uneven(current))
    quadratic, edges, default = (dense_flow(*images, model=model) for model in MODELS)
    assert torch.equal(default.displacement.nan_to_num(), quadratic.displacement.nan_to_num())
    of_quadratic, of_edges = (errors(one.displacement, truth, 16).nanmean() for one in (quadratic, edges))
    assert of_edges > 2 * of_quadratic
    assert default.residual.nanmean() > 3 * LEFT_BY_NOISE["brightness"] * 2.0
