"""Tests of tracking against exact shifts of an analytic texture and against the Cramer-Rao bound."""

import math
from collections.abc import Callable
from functools import cache

import pytest
import torch
from torch import Tensor

from fingerflow.ops.tracking.corners import detect_corners
from fingerflow.ops.tracking.track_points import Tracks, TrackStatus, track_points
from fingerflow.synthetic import RidgeTexture, texture_image

MM = 0.0325
SHAPE = (400, 480)
TEXTURE = RidgeTexture(centre=(7.0, 6.0))


def grey(x: Tensor, y: Tensor) -> Tensor:
    return 110 + 80 * TEXTURE(x, y)


def moved_by(shift: tuple[float, float]) -> Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]:
    """Return the mapping from a position (mm) to its position in the skin before a shift (px)."""
    return lambda x, y: (x - shift[0] * MM, y - shift[1] * MM)


@cache
def picture(shift: tuple[float, float], noise: float, seed: int) -> Tensor:
    clean = texture_image(grey, SHAPE, MM, moved_by(shift))
    generator = torch.Generator().manual_seed(seed)
    noisy = clean + noise * torch.randn(clean.shape, generator=generator, dtype=clean.dtype)
    return noisy.round().clamp(0, 255).to(torch.uint8)


@pytest.fixture(scope="module")
def points() -> Tensor:
    mask = torch.zeros(1, 1, *SHAPE, dtype=torch.bool)
    mask[..., 40:-40, 40:-40] = True
    found = detect_corners(picture((0, 0), 0, 0), 500, 8.0, mask, window=21)
    return found.points[:, found.valid[0]]


def bound(points: Tensor, noise: float, window: int = 21) -> float:
    """Return the Cramer-Rao bound of the RMS distance, px: sqrt of the mean trace of 2 sigma^2 G^-1."""
    offset = torch.arange(-(window // 2), window // 2 + 1, dtype=torch.float64)
    x = (points[0, :, 0, None, None].double() + offset).expand(-1, window, -1).clone().requires_grad_()
    y = (points[0, :, 1, None, None].double() + offset[:, None]).expand(-1, -1, window).clone().requires_grad_()
    gx, gy = torch.autograd.grad(grey(x * MM, y * MM).sum(), (x, y))
    g = torch.stack((gx.flatten(1), gy.flatten(1)), dim=1)
    covariance = 2 * (noise**2 + 1 / 12) * torch.linalg.inv(g @ g.transpose(1, 2))
    return float(covariance.diagonal(dim1=1, dim2=2).sum(-1).mean().sqrt())


@pytest.mark.parametrize("noise", [0, 2, 5])
@pytest.mark.parametrize("fraction", [0.0, 0.37])
def test_error_is_at_the_bound_and_without_bias(points: Tensor, noise: float, fraction: float) -> None:
    """The error is below 1.1 of the Cramer-Rao bound and the bias below 0.001 px plus three standard errors of the
    mean, the least that this number of points can resolve.
    """
    start = points + fraction
    errors = []
    for seed, shift in enumerate((0.0, 0.25, 0.5, 0.9, 1.0, -1.0)):
        if noise == 0 and shift == 0:
            continue  # equal images without motion: the result is exact
        motion = (shift, 0.6 * shift)
        tracks = track_points(picture((0, 0), noise, 2 * seed), picture(motion, noise, 2 * seed + 1), start)
        assert (tracks.status == TrackStatus.TRACKED).all()
        errors.append((tracks.points - start - torch.tensor(motion))[0].double())
    error = torch.cat(errors)
    assert error.square().sum(-1).mean().sqrt() < 1.1 * bound(start, noise)
    assert (error.mean(0).abs() < 0.001 + 3 * error.std(0) / math.sqrt(len(error))).all()


def test_covariance_is_that_of_the_errors(points: Tensor) -> None:
    """The mean of e' C^-1 e is near 2, its expected value; smoothing makes the stated covariance slightly too large."""
    tracks = track_points(picture((0, 0), 2, 1), picture((0.4, 0.2), 2, 2), points)
    error = (tracks.points - points - torch.tensor((0.4, 0.2)))[0]
    squares = (error[:, None] @ torch.linalg.inv(tracks.covariance[0]) @ error[..., None]).mean()
    assert 1.2 < float(squares) < 2.3


@pytest.mark.parametrize("search", [0, 64])
@pytest.mark.parametrize("motion", [(4.0, 3.0), (40.0, 30.0)])
def test_large_motion_is_found_or_flagged(points: Tensor, motion: tuple[float, float], search: int) -> None:
    tracks = track_points(picture((0, 0), 2, 3), picture(motion, 2, 4), points, search=search)
    tracked = tracks.status == TrackStatus.TRACKED
    distance = (tracks.points - points - torch.tensor(motion)).norm(dim=-1)
    assert (tracked & (distance > 0.5)).float().mean() <= 0.005
    if search:
        assert tracked.float().mean() > 0.75  # most of the others leave the frame
        assert distance[tracked].square().mean().sqrt() < 0.05


def test_warp_is_needed_and_serves(points: Tensor) -> None:
    stretch = torch.tensor([[1.05, 0.02], [-0.03, 1.06]], dtype=torch.float64)
    centre = torch.tensor([240.0, 200.0], dtype=torch.float64)
    back = torch.linalg.inv(stretch)

    def mapping(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        x, y = x / MM - centre[0], y / MM - centre[1]
        return ((back[0, 0] * x + back[0, 1] * y + centre[0]) * MM, (back[1, 0] * x + back[1, 1] * y + centre[1]) * MM)

    first = texture_image(grey, SHAPE, MM).float()
    second = texture_image(grey, SHAPE, MM, mapping).float()
    truth = ((points.double() - centre) @ stretch.T + centre).float()
    warp = stretch.float().expand(1, points.shape[1], 2, 2)
    with_warp = track_points(first, second, points, initial=truth + 0.3, warp=warp)
    without = track_points(first, second, points, initial=truth + 0.3, passes=1)
    learned = track_points(first, second, points, initial=truth + 0.3)
    inside = with_warp.status == TrackStatus.TRACKED
    assert inside.float().mean() > 0.9
    assert (with_warp.points - truth)[inside].norm(dim=-1).max() < 0.02
    assert with_warp.error[inside].max() < 0.02  # without noise the backward check returns to its start
    plain = without.status == TrackStatus.TRACKED
    assert (without.points - truth)[plain].norm(dim=-1).median() > 0.05
    known = learned.status == TrackStatus.TRACKED
    assert known.float().mean() > 0.9
    assert (learned.points - truth)[known].norm(
        dim=-1
    ).median() < 0.012  # the second pass uses the warp found by the first


def test_gain_and_offset(points: Tensor) -> None:
    first = texture_image(grey, SHAPE, MM).float()
    second = 0.8 * texture_image(grey, SHAPE, MM, lambda x, y: (x - 0.4 * MM, y)).float() + 20
    tracks = track_points(first, second, points)
    assert (tracks.status == TrackStatus.TRACKED).all()
    assert (tracks.points - points - torch.tensor((0.4, 0.0))).norm(dim=-1).max() < 0.01
    bound = track_points(first, second, points, gain_offset=False, mismatch_limit=1.0, forward_backward_limit=10.0)
    moved = (bound.points - points - torch.tensor((0.4, 0.0))).norm(dim=-1)
    assert moved.nan_to_num(1.0).median() > 0.05


@pytest.mark.parametrize("gain_offset", [False, True])
@pytest.mark.parametrize("passes", [1, 2])
def test_derivative_with_respect_to_images_and_points(passes: int, gain_offset: bool) -> None:
    y, x = torch.meshgrid(*(torch.arange(float(n), dtype=torch.float64) for n in (24, 26)), indexing="ij")

    def wave(x: Tensor, y: Tensor) -> Tensor:
        return 100 + 40 * torch.sin(0.7 * x + 0.3 * y) + 30 * torch.cos(0.5 * y - 0.2 * x) + 10 * torch.sin(0.9 * y + x)

    first = wave(x, y)[None, None].requires_grad_()
    second = wave(x - 0.3, y + 0.2)[None, None].requires_grad_()
    start = torch.tensor([[[12.3, 11.2], [13.0, 12.0]]], dtype=torch.float64, requires_grad=True)

    def found(a: Tensor, b: Tensor, p: Tensor) -> Tensor:
        return track_points(a, b, p, 7, passes=passes, gain_offset=gain_offset, mismatch_limit=1.0).points

    assert torch.autograd.gradcheck(found, (first, second, start), eps=1e-6, atol=1e-5, rtol=1e-4, fast_mode=True)


def status(tracks: Tracks) -> list[int]:
    return tracks.status[0].tolist()


def test_nothing_to_track_is_said(points: Tensor) -> None:
    blank = torch.full((1, 1, *SHAPE), 255, dtype=torch.uint8)
    assert set(status(track_points(blank, blank, points))) == {TrackStatus.NO_TEXTURE}
    generator = torch.Generator().manual_seed(0)
    noise = (100 + 3 * torch.randn(1, 1, *SHAPE, generator=generator)).round().to(torch.uint8)
    assert TrackStatus.TRACKED not in status(track_points(noise, noise.flip(3), points))
    grating = (100 + 50 * torch.sin(torch.arange(SHAPE[1]) / 3.0)).expand(1, 1, *SHAPE)
    assert set(status(track_points(grating, grating, points))) == {TrackStatus.NO_TEXTURE}


def test_border_and_missing_points(points: Tensor) -> None:
    first, second = picture((0, 0), 1, 6), picture((0.3, 0.1), 1, 7)
    odd = torch.tensor([[[3.0, 200.0], [475.0, 200.0], [1e6, 5.0], [torch.nan, 5.0], [200.0, 200.0]]])
    found = status(track_points(first, second, odd))
    assert found[:3] == [TrackStatus.LEFT_FRAME] * 3
    assert found[3] == TrackStatus.NOT_FINITE
