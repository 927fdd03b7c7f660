"""Tests of dense flow by grey levels and their gradient: light that varies over the image, and residuals
due to noise.
"""

import torch
from torch import Tensor

from fingerflow.ops import dense_flow
from fingerflow.ops.flow.flow_constancy import LEFT_BY_NOISE
from fingerflow.ops.flow.flow_penalty import FlowModel
from tests.ops.flow.test_dense_flow import errors, grid, pair, photograph, wave

MODELS: tuple[FlowModel, ...] = ("quadratic", "edges", "auto")


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
