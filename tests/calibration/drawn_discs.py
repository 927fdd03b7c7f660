"""Drawn calibration targets whose discs are exactly known."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Optical blur of the drawings, px: a lens is never sharper than its pixels.
BLUR_PX = 0.8
SUPERSAMPLING = 16


@dataclass(frozen=True)
class DrawnDisc:
    """An ellipse: semi-axes px, angle rad from x towards y."""

    x: float
    y: float
    long: float
    short: float
    angle: float = 0.0


TARGET = (
    DrawnDisc(88.3, 61.7, 30, 28, 0.4),
    DrawnDisc(180.62, 92.15, 22.5, 20.5, 1.2),
    DrawnDisc(110.4, 186.8, 23, 21, 2.5),
)


def draw(
    discs: tuple[DrawnDisc, ...], shape: tuple[int, int] = (256, 272), bright: float = 120.0, dark: float = 80.0
) -> Array:
    """Dark discs on a bright ground (H, W): the exact area of every pixel to 1/256, then the blur of a lens."""
    covered = np.zeros(shape)
    for disc in discs:
        reach = int(disc.long) + 3
        top, left = max(0, int(disc.y) - reach), max(0, int(disc.x) - reach)
        bottom, right = min(shape[0], int(disc.y) + reach + 1), min(shape[1], int(disc.x) + reach + 1)
        fine = (np.arange(SUPERSAMPLING) + 0.5) / SUPERSAMPLING - 0.5
        y = (np.arange(top, bottom)[:, None] + fine).ravel()[:, None] - disc.y
        x = (np.arange(left, right)[:, None] + fine).ravel() - disc.x
        along, across = x * np.cos(disc.angle) + y * np.sin(disc.angle), y * np.cos(disc.angle) - x * np.sin(disc.angle)
        inside = (along / disc.long) ** 2 + (across / disc.short) ** 2 < 1
        blocks = inside.reshape(bottom - top, SUPERSAMPLING, right - left, SUPERSAMPLING)
        part = covered[top:bottom, left:right]
        np.maximum(part, blocks.mean(axis=(1, 3)), out=part)
    return np.asarray(cv2.GaussianBlur(bright + (dark - bright) * covered, (0, 0), BLUR_PX), dtype=np.float64)


def camera(levels: Array, noise: float, seed: int = 0) -> NDArray[np.uint8]:
    """What an 8-bit camera with so many grey levels of noise makes of it."""
    noisy = levels + np.random.default_rng(seed).normal(0, noise, levels.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def turned(discs: tuple[DrawnDisc, ...], degrees: float, center: tuple[float, float]) -> tuple[DrawnDisc, ...]:
    """The discs turned about a point, from x towards y."""
    angle = np.radians(degrees)
    cosine, sine = np.cos(angle), np.sin(angle)
    x0, y0 = center
    return tuple(
        DrawnDisc(
            x0 + cosine * (disc.x - x0) - sine * (disc.y - y0),
            y0 + sine * (disc.x - x0) + cosine * (disc.y - y0),
            disc.long,
            disc.short,
            disc.angle + angle,
        )
        for disc in discs
    )
