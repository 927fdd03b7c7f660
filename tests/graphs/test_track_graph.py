"""What tracking adds to the single point: its deformation, what that does to a position, and its neighbours."""

import torch
from torch import Tensor

from fingerflow.graphs.track import AgreementGraph, DeformationGraph, lean_of
from fingerflow.ops.outliers import find_neighbours
from fingerflow.ops.templates import Found, find_templates, prepare_templates
from fingerflow.ops.tracking_limits import TrackStatus
from fingerflow.synthetic import RidgeTexture, texture_image

MM = 0.0325
SHAPE = (300, 360)
MIDDLE = torch.tensor([180.0, 150.0], dtype=torch.float64)
TEXTURE = RidgeTexture(centre=(5.0, 4.5))


def picture(deformation: Tensor) -> Tensor:
    """Skin deformed by F about the middle, float, (1, 1, H, W)."""
    back = torch.linalg.inv(deformation)

    def material(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        place = (torch.stack((x / MM, y / MM), -1) - MIDDLE) @ back.T + MIDDLE
        return place[..., 0] * MM, place[..., 1] * MM

    return texture_image(lambda x, y: 110 + 80 * TEXTURE(x, y), SHAPE, MM, material).float()


def grid() -> Tensor:
    x, y = torch.meshgrid(torch.arange(40.0, 320, 14), torch.arange(40.0, 260, 14), indexing="xy")
    return torch.stack((x, y), -1).reshape(1, -1, 2)


def test_a_template_that_does_not_know_the_deformation_leans_as_far_as_stated() -> None:
    """Stretched by 2 %, the edge of a window of 25 px is off by a quarter of a pixel: less than a fifth of what leans
    is left. At the corners of the cloud the fits are one-sided."""
    deformation = torch.tensor([[1.02, 0.004], [-0.006, 0.985]], dtype=torch.float64)
    points = grid()
    truth = ((points.double() - MIDDLE) @ deformation.T + MIDDLE).float()
    templates = prepare_templates(picture(torch.eye(2, dtype=torch.float64)), points, 25)
    found = find_templates(templates, picture(deformation), truth)
    assert (found.status == TrackStatus.TRACKED).all()
    inverse = torch.eye(2).expand(1, points.shape[1], 2, 2)
    deformed = DeformationGraph(25)(points, found.points, lean_of(templates), inverse)
    before, after = ((one - truth).norm(dim=-1) for one in (found.points, deformed.points))
    assert before.square().mean().sqrt() > 0.02
    assert after.square().mean().sqrt() < 0.2 * before.square().mean().sqrt()
    assert (deformed.warp - deformation.float()).abs().amax() < 5e-3
    assert (deformed.expected - truth).norm(dim=-1).max() < 0.15  # a mean over points that lean


def test_points_elsewhere_and_unsure_ones_are_marked_and_lost() -> None:
    start = grid()
    generator = torch.Generator().manual_seed(0)
    count = start.shape[1]
    points = start + 0.01 * (start - 150) + 0.01 * torch.randn(3, count, 2, generator=generator)
    points[1, 100] += 3.0
    variance = torch.full((3, count), 1e-4)
    variance[2, 200] = 0.05
    status = torch.zeros(3, count, dtype=torch.uint8)
    status[0, 7] = TrackStatus.MISMATCH
    points[0, 7] = torch.nan
    covariance = variance[..., None, None] * torch.eye(2)
    found = Found(points, variance.sqrt(), covariance, status, points.nan_to_num(0.0))
    marked = AgreementGraph()(find_neighbours(start, 120.0), start, found)
    expected = status.clone()
    expected[1, 100], expected[2, 200] = TrackStatus.OFF_NEIGHBOURS, TrackStatus.UNCERTAIN
    assert torch.equal(marked.status, expected)
    assert torch.equal(marked.points.isnan().any(-1), expected != TrackStatus.TRACKED)
    assert torch.equal(marked.covariance.isnan().flatten(2).any(-1), expected != TrackStatus.TRACKED)
