"""Tests of dense flow on ridges whose motion is known at every pixel, and on images without texture."""

from collections.abc import Callable
from functools import cache

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from bench.suites.flow import ridges
from fingerflow.ops import dense_flow
from fingerflow.ops.flow.flow_penalty import Penalty

HEIGHT, WIDTH = 128, 160
Motion = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
GREY = ridges(200)
PENALTIES = pytest.mark.parametrize("penalty", ["quadratic", "charbonnier"])
CONSTANCIES = pytest.mark.parametrize("constancy", ["brightness", "both"])


def grid(shape: tuple[int, int] = (HEIGHT, WIDTH)) -> tuple[Tensor, Tensor]:
    y, x = torch.meshgrid(*(torch.arange(side, dtype=torch.float64) for side in shape), indexing="ij")
    return x, y


@cache
def pair(motion: Motion, noise: float = 0.0, seed: int = 0, shape: tuple[int, int] = (HEIGHT, WIDTH)) -> tuple:
    """Return both images (1, 1, H, W) (float64, not rounded) and the true displacement (1, 2, H, W) px."""
    x, y = grid(shape)
    material_x, material_y = x, y
    for _ in range(40):
        u, v = motion(material_x, material_y)
        material_x, material_y = x - u, y - v
    generator = torch.Generator().manual_seed(seed)
    images = [
        grey[None, None] + noise * torch.randn(1, 1, *shape, generator=generator, dtype=torch.float64)
        for grey in (GREY(x, y), GREY(material_x, material_y))
    ]
    return *images, torch.stack(motion(x, y))[None]


def wave(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Return a displacement of up to 1.2 px with strains of up to 2 %."""
    return 0.7 * torch.sin(x / 40 + 0.3) + 0.5 * torch.cos(y / 50), 0.8 * torch.cos((x + y) / 60)


def widening(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    return 0.03 * (x - 80) - 0.01 * (y - 60), 0.01 * (x - 80) + 0.02 * (y - 60)


def photograph(image: Tensor) -> Tensor:
    return image.round().clamp(0, 255).to(torch.uint8)


def errors(found: Tensor, truth: Tensor, border: int = 0) -> Tensor:
    apart = (found - truth).norm(dim=1)
    return apart[:, border : apart.shape[1] - border, border : apart.shape[2] - border]


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.4, -0.3), (-2.0, 1.7)])
def test_a_shift_without_noise_is_found(shift: tuple[float, float]) -> None:
    """A shift is found to 0.005 px on average, and to 0.03 px from 8 px inside the border on.

    The spline's low-pass is the same for both images. Its interpolation remains as an error, and at the border, where
    pixels leave the image, the start from zero motion.
    """
    first, current, truth = pair(lambda x, y: (0 * x + shift[0], 0 * y + shift[1]))
    known = errors(dense_flow(first, current, noise=torch.tensor([0.1])).displacement, truth)
    assert known.nanmean() < 5e-3
    assert known[:, 8:-8, 8:-8].max() < 0.03


@pytest.mark.parametrize("motion", [wave, widening])
def test_skin_that_stretches(motion: Motion) -> None:
    """With 8 bits and noise of 2 grey levels the mean error is below 0.015 px in the interior, below 0.02 px with the
    border, where windows are cut, and below 0.6 of the error of OpenCV's Farneback flow.
    """
    first, current, truth = pair(motion, noise=2.0)
    flow = dense_flow(photograph(first), photograph(current))
    inner = errors(flow.displacement, truth, 24)
    assert inner.nanmean() < 0.015
    assert errors(flow.displacement, truth).nanmean() < 0.02
    farneback = cv2.calcOpticalFlowFarneback(
        *(photograph(one)[0, 0].numpy() for one in (first, current)), None, 0.5, 3, 21, 5, 7, 1.5, 0
    )
    peer = errors(torch.from_numpy(np.moveaxis(farneback, 2, 0))[None], truth, 24)
    assert inner.nanmean() < 0.6 * peer.mean()


@PENALTIES
def test_the_deviation_covers_the_error(penalty: Penalty) -> None:
    z = []
    for seed in range(4):
        first, current, truth = pair(widening, noise=3.0, seed=seed)
        flow = dense_flow(first, current, noise=torch.tensor([3.0]), model=penalty)
        variance = torch.stack((flow.covariance[:, 0, 0], flow.covariance[:, 1, 1]), dim=1)
        z.append(((flow.displacement - truth) ** 2 / variance)[..., 12:-12, 12:-12].nanmean())
    assert 0.8 < float(torch.stack(z).mean().sqrt()) < 1.25
    assert 0.3 * 3 < float(flow.residual.nanmean()) < 0.5 * 3  # as stated in the docstring of `dense_flow`


def test_light_that_changes_moves_nothing() -> None:
    first, current, truth = pair(wave, noise=1.0)
    steady = dense_flow(first, current)
    flow = dense_flow(first, 0.8 * current + 11)
    assert (flow.displacement - steady.displacement).nan_to_num().abs().max() < 1e-4
    assert errors(flow.displacement, truth, 24).nanmean() < 0.015
    assert flow.covariance[:, 0, 0].nanmean() > 1.2 * steady.covariance[:, 0, 0].nanmean()  # as noise counts more


def test_nothing_outside_the_mask_counts() -> None:
    """Pixels outside the mask do not change the flow, except those within reach of the spline at the mask's border."""
    first, current, truth = pair(widening, noise=1.0)
    x, y = grid()
    mask = (((x - 80) / 60) ** 2 + ((y - 64) / 45) ** 2 < 1)[None, None]
    around = torch.nn.functional.max_pool2d(mask.double(), 13, 1, 6) > 0
    other = [torch.where(around, one, 255 - one.flip(3)) for one in (first, current)]
    noise = torch.tensor([1.0])
    one, two = (dense_flow(*images, mask=mask, noise=noise) for images in ((first, current), other))
    assert one.displacement.isfinite().all(1).eq(mask[:, 0]).all()
    assert (one.displacement - two.displacement).nan_to_num().abs().max() < 5e-3
    # Skin widens up to the border of the mask: smoothing does not flatten the motion there.
    assert errors(one.displacement, truth).nanmean() < 0.015


def test_large_motion_from_where_it_is_expected() -> None:
    """A motion of 16 px is found from a prediction that is 1 px off in x and y; without a prediction, halving the
    images fails on ridges.
    """
    first, current, truth = pair(lambda x, y: (0 * x + 13.0, 0 * y - 9.0), noise=2.0)
    flow = dense_flow(photograph(first), photograph(current), initial=truth.float() + 1.0, warps=4)
    known = errors(flow.displacement, truth)
    inside = known.isfinite()
    assert 0.75 < inside.double().mean() < 0.9  # pixels that left the image have no displacement
    assert known[inside].mean() < 0.04  # 0.2 px where half of a window has left the image
    assert errors(flow.displacement, truth, 24).nanmean() < 0.015


@pytest.mark.parametrize("level", [0, 128, 255])
def test_blank_images_move_nowhere_and_say_so(level: int) -> None:
    blank = torch.full((1, 1, 40, 48), level, dtype=torch.uint8)
    flow = dense_flow(blank, blank)
    assert (flow.displacement == 0).all()
    assert flow.covariance.isnan().all()


@PENALTIES
def test_differentiable_in_both_images(penalty: Penalty) -> None:
    """Derivatives by both images, through every warp and cycle, equal central differences in float64."""
    first, current, _ = (one[..., :24, :32] for one in pair(wave, shape=(32, 40)))
    weight = torch.randn(1, 2, 24, 32, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    noise = torch.tensor([1.0], dtype=torch.float64)

    def total(first: Tensor, current: Tensor) -> Tensor:
        flow = dense_flow(first, current, torch.zeros_like(weight), warps=2, noise=noise, model=penalty)
        return (flow.displacement.nan_to_num() * weight).sum()

    images = [one.clone().requires_grad_() for one in (first, current)]
    total(*images).backward()
    for k, image in enumerate(images):
        direction = torch.randn(image.shape, generator=torch.Generator().manual_seed(2 + k), dtype=torch.float64)
        either = []
        for sign in (1, -1):
            moved = [one.detach() + sign * 1e-5 * direction * (place == k) for place, one in enumerate(images)]
            either.append(total(*moved))
        expected = (either[0] - either[1]) / 2e-5
        torch.testing.assert_close((image.grad * direction).sum(), expected, rtol=2e-4, atol=1e-6)
