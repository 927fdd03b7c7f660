"""Synthetic skin images with known motion, and the Cramer-Rao bound of tracking errors in them."""

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
Texture = Callable[[Tensor, Tensor], Tensor]
Motion = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]


def grey(x: Tensor, y: Tensor) -> Tensor:
    """Return grey levels of the skin at material positions in px: mean 110, 30 to 190, so that noise never clips."""
    return 110 + 80 * _TEXTURE(x * MM_PER_PX, y * MM_PER_PX)


@lru_cache(maxsize=16)
def clean_picture(shape: tuple[int, int], shift: Shift) -> Tensor:
    """Return the skin moved by ``shift`` px, without noise and rounding, (1, 1, H, W) float64."""
    return texture_image(grey, shape, 1.0, lambda x, y: (x - shift[0], y - shift[1]))


def photograph(clean: Tensor, noise: float, seed: int) -> Tensor:
    """Return a picture as an 8-bit camera gives it: white noise of ``noise`` grey levels, rounded to uint8."""
    generator = torch.Generator().manual_seed(seed)
    noisy = clean + noise * torch.randn(clean.shape, generator=generator, dtype=clean.dtype)
    return noisy.round().clamp(0, 255).to(torch.uint8)


def photograph_pair(shape: tuple[int, int], motion: Shift, noise: float, number: int) -> tuple[Tensor, Tensor]:
    """Return photographs of the skin at rest and moved by ``motion`` px; pairs of another number have another noise."""
    previous = photograph(clean_picture(shape, (0.0, 0.0)), noise, seed=2 * number)
    return previous, photograph(clean_picture(shape, motion), noise, seed=2 * number + 1)


def photograph_motion(texture: Texture, motion: Motion, shape: tuple[int, int], noise: float) -> tuple[Tensor, Tensor]:
    """Return photographs of a texture at rest and after a motion: the displacement (u, v) px of what is at (x, y)."""

    def material(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        there_x, there_y = x, y
        for _ in range(30):  # a strain of 0.08, the largest here, leaves 1e-33 of the error
            along_x, along_y = motion(there_x, there_y)
            there_x, there_y = x - along_x, y - along_y
        return there_x, there_y

    still, moved = (texture_image(texture, shape, 1.0, mapping) for mapping in (None, material))
    return photograph(still, noise, 0), photograph(moved, noise, 1)


def choose_points(shape: tuple[int, int], count: int, border: int) -> Tensor:
    """Return corners (1, N, 2) on whole pixels, at most ``count``, at least ``border`` px inside the frame."""
    corners = detect_corners(clean_picture(shape, (0.0, 0.0)), count, 8.0, window=21, border=border)
    return corners.points[:, corners.valid[0]].float()


def error_bound(points: Tensor, noise: float, window: int) -> Tensor:
    """Compute the Cramer-Rao bound of a displacement between two noisy pictures.

    No unbiased estimate has less covariance than 2 sigma^2 G^-1. G is the sum of grad grad' of the clean skin over the
    window, by automatic differentiation in float64; sigma^2 = noise^2 + 1/12 includes the rounding.

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
