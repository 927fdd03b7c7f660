"""Tests of what the tracking graph adds to single points: deformation and its effect on positions."""

from typing import Any

import pytest
import torch
from torch import Tensor

from fingerflow.kernels.result_records import TrackedPoints
from fingerflow.kernels.tracking_limits import WARP_GAUGE_PX, TrackStatus
from fingerflow.ops.tracking.deformation import correct_points
from fingerflow.ops.tracking.templates import Templates, find_templates, inverse_2x2, prepare_templates
from fingerflow.synthetic import RidgeTexture, texture_image

MM = 0.0325
SHAPE = (300, 360)
MIDDLE = torch.tensor([180.0, 150.0], dtype=torch.float64)
TEXTURE = RidgeTexture(centre=(5.0, 4.5))


def picture(deformation: Tensor) -> Tensor:
    """Return skin deformed by F about the middle, float (1, 1, H, W)."""
    back = torch.linalg.inv(deformation)

    def material(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        place = (torch.stack((x / MM, y / MM), -1) - MIDDLE) @ back.T + MIDDLE
        return place[..., 0] * MM, place[..., 1] * MM

    return texture_image(lambda x, y: 110 + 80 * TEXTURE(x, y), SHAPE, MM, material).float()


def grid() -> Tensor:
    x, y = torch.meshgrid(torch.arange(40.0, 320, 14), torch.arange(40.0, 260, 14), indexing="xy")
    return torch.stack((x, y), -1).reshape(1, -1, 2)


def deformed_grid() -> tuple[Tensor, Tensor, Tensor]:
    """Return points, a deformation that stretches by 2 %, and the points where it takes them."""
    points, deformation = grid(), torch.tensor([[1.02, 0.004], [-0.006, 0.985]], dtype=torch.float64)
    return points, deformation, ((points.double() - MIDDLE) @ deformation.T + MIDDLE).float()


def corrected_for_deformation(points: Tensor, found: TrackedPoints, templates: Templates, inverse_warp: Tensor) -> Any:
    """Return the points with their positions and covariances corrected, the deformation and expected positions."""
    given = points, found.points, found.covariance, templates.numbers, inverse_warp
    position, covariance, warp, _, expected = correct_points(*given, 25, WARP_GAUGE_PX)
    return found._replace(points=position, covariance=covariance), warp, expected


def test_a_template_that_does_not_know_the_deformation_leans_as_far_as_stated() -> None:
    """The correction leaves less than a fifth of the bias of templates that do not know the deformation: with a stretch
    of 2 % the edge of a window of 25 px is off by a quarter of a pixel. At the corners of the cloud of points fits are
    one-sided.
    """
    points, deformation, truth = deformed_grid()
    templates = prepare_templates(picture(torch.eye(2, dtype=torch.float64)), points, 25)
    found = find_templates(templates, picture(deformation), truth)
    assert (found.status == TrackStatus.TRACKED).all()
    inverse = torch.eye(2).expand(1, points.shape[1], 2, 2)
    corrected, warp, expected = corrected_for_deformation(points, found, templates, inverse)
    before, after = ((one - truth).norm(dim=-1) for one in (found.points, corrected.points))
    assert before.square().mean().sqrt() > 0.02
    assert after.square().mean().sqrt() < 0.2 * before.square().mean().sqrt()
    assert (warp - deformation.float()).abs().amax() < 5e-3
    assert (expected - truth).norm(dim=-1).max() < 0.15  # a mean over points with a bias


@pytest.mark.parametrize("gain_offset", [True, False])
def test_the_stated_deviation_does_not_count_the_deformation_as_noise(gain_offset: bool) -> None:
    """The correction removes the deformation from the stated variance: with templates that do not know a stretch of
    0.25 px at the edges, the residual has five times the energy of the noise. Corrected variances are those of
    templates that know the stretch to a tenth, the effect of second order.
    """
    points, deformation, truth = deformed_grid()
    generator = torch.Generator().manual_seed(0)
    key, frame = (
        picture(one) + 2 * torch.randn(1, 1, *SHAPE, generator=generator)
        for one in (torch.eye(2, dtype=torch.float64), deformation)
    )
    straight = torch.eye(2).expand(1, points.shape[1], 2, 2)
    known = deformation.float().expand_as(straight)
    ratios = []
    for warp in (straight, known):
        templates = prepare_templates(key, points, 25, warp, gain_offset=gain_offset, noise=torch.full((1,), 2.0))
        found = find_templates(templates, frame, truth)
        corrected, *_ = corrected_for_deformation(points, found, templates, inverse_2x2(warp))
        assert (corrected.covariance.det() > 0).all()
        ratios += [one.variance.mean() for one in (found, corrected)]
    naive, corrected_variance, known_variance, known_corrected = ratios
    assert naive > 4 * known_variance
    assert 0.9 < corrected_variance / known_variance < 1.15
    assert 0.99 < known_corrected / known_variance <= 1  # a known deformation changes nothing
