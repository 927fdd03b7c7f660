"""Drawn calibration targets whose discs are known exactly."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fingerflow.calibration import Disc

Array = NDArray[np.float64]

# Optical blur of the drawings, px.
BLUR_PX = 0.8
SUPERSAMPLING = 16


@dataclass(frozen=True)
class DrawnDisc:
    """An ellipse with its centre and semi-axes in px and its angle in rad from x towards y."""

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
    """Return dark discs on a bright ground (H, W): pixels have their covered area exact to 1/256, then the blur of a
    lens.
    """
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
    """Return the picture as uint8 with `noise` grey levels of noise, as an 8-bit camera gives it."""
    noisy = levels + np.random.default_rng(seed).normal(0, noise, levels.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def moved(discs: tuple[DrawnDisc, ...], matrix: Array) -> tuple[DrawnDisc, ...]:
    """Return the discs after an affine transform (2, 3) of the plane."""
    result = []
    for disc in discs:
        cosine, sine = np.cos(disc.angle), np.sin(disc.angle)
        # An ellipse is a circle of radius 1 under this map; the axes of a map are its singular vectors.
        circle_to_ellipse = (
            matrix[:, :2] @ np.array([[cosine, -sine], [sine, cosine]]) @ np.diag([disc.long, disc.short])
        )
        directions, (long, short), _ = np.linalg.svd(circle_to_ellipse)
        x, y = matrix @ (disc.x, disc.y, 1)
        result.append(DrawnDisc(x, y, long, short, float(np.arctan2(directions[1, 0], directions[0, 0]))))
    return tuple(result)


def similarity(degrees: float, scale: float, center: tuple[float, float], to: tuple[float, float]) -> Array:
    """Return the transform (2, 3) that turns from x towards y and scales about `center`, and moves `center` to `to`."""
    cosine, sine = scale * np.cos(np.radians(degrees)), scale * np.sin(np.radians(degrees))
    linear = np.array([[cosine, -sine], [sine, cosine]])
    return np.column_stack([linear, np.array(to) - linear @ np.array(center)])


def as_found(discs: tuple[DrawnDisc, ...]) -> list[Disc]:
    """Return the discs as a finder without error gives them; larger discs are more significant."""
    return [
        Disc(
            center=(disc.x, disc.y),
            semi_axes_px=(disc.long, disc.short),
            angle=disc.angle % np.pi,
            center_sigma_px=0.0,
            edge_rms_px=0.0,
            coverage=1.0,
            contrast=0.3,
            significance=10 * disc.short**0.5,
        )
        for disc in discs
    ]
