"""Pictures of skin that moved by a known amount, and how well such motion can be measured at all."""

from collections.abc import Callable
from functools import lru_cache

import torch
from torch import Tensor

from fingerflow.ops.tracking.corners import detect_corners
from fingerflow.synthetic import RidgeTexture, texture_image

MM_PER_PX = 0.0325
SHAPE = (512, 640)
QUICK_SHAPE = (256, 320)
_TEXTURE = RidgeTexture(centre=(10.0, 8.0))

Shift = tuple[float, float]


def grey(x: Tensor, y: Tensor) -> Tensor:
    """Grey level of the skin at material positions in px: 110 on average, 30 to 190 at most, so noise never clips."""
    return 110 + 80 * _TEXTURE(x * MM_PER_PX, y * MM_PER_PX)


@lru_cache(maxsize=16)
def clean_picture(shape: tuple[int, int], shift: Shift) -> Tensor:
    """The skin moved by ``shift`` px without noise and rounding, (1, 1, H, W) float64."""
    return deformed_picture(shape, lambda x, y: (x - shift[0], y - shift[1]))


def deformed_picture(
    shape: tuple[int, int],
    material: Callable[[Tensor, Tensor], tuple[Tensor, Tensor]],
    dtype: torch.dtype = torch.float64,
) -> Tensor:
    """The skin (1, 1, H, W) where a pixel shows the material position (px) that ``material`` gives for it."""
    return texture_image(grey, shape, 1.0, material, dtype)


def photograph(clean: Tensor, noise: float, seed: int) -> Tensor:
    """A camera of 8 bit: white noise of ``noise`` grey levels, rounded to uint8."""
    generator = torch.Generator().manual_seed(seed)
    noisy = clean + noise * torch.randn(clean.shape, generator=generator, dtype=clean.dtype)
    return noisy.round().clamp(0, 255).to(torch.uint8)


def photograph_pair(shape: tuple[int, int], motion: Shift, noise: float, number: int) -> tuple[Tensor, Tensor]:
    """Return photographs of the skin at rest and moved by ``motion`` px; pairs of another number have another noise."""
    previous = photograph(clean_picture(shape, (0.0, 0.0)), noise, seed=2 * number)
    return previous, photograph(clean_picture(shape, motion), noise, seed=2 * number + 1)


def choose_points(shape: tuple[int, int], count: int, border: int) -> Tensor:
    """(1, N, 2) whole-pixel corners of the skin, N at most ``count``, at least ``border`` px inside the frame."""
    corners = detect_corners(clean_picture(shape, (0.0, 0.0)), count, 8.0, window=21, border=border)
    return corners.points[:, corners.valid[0]].float()


def error_bound(points: Tensor, noise: float, window: int) -> Tensor:
    """The Cramer-Rao bound of a displacement between two noisy pictures: no unbiased estimate has less covariance.

    2 sigma^2 G^-1 with G the sum of grad grad' of the clean skin over the window, by automatic differentiation of the
    formula in float64, and sigma^2 = noise^2 + 1/12 for the rounding.

    Args:
        points: (1, N, 2) px.

    Returns:
        (N, 2, 2) px^2.
    """
    offset = torch.arange(-(window // 2), window // 2 + 1, dtype=torch.float64)
    x = (points[0, :, 0, None, None].double() + offset).expand(-1, window, -1).clone().requires_grad_()
    y = (points[0, :, 1, None, None].double() + offset[:, None]).expand(-1, -1, window).clone().requires_grad_()
    slopes = torch.autograd.grad(grey(x, y).sum(), (x, y))
    flat = torch.stack([slope.flatten(1) for slope in slopes], dim=1)
    result: Tensor = 2 * (noise**2 + 1 / 12) * torch.linalg.inv(flat @ flat.mT)
    return result
