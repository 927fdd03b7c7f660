"""Tests of loop, whorl and arch against known properties of fingerprints, by methods independent of the formula."""

import math

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from fingerflow.synthetic import FingerprintTexture, texture_image

pytestmark = pytest.mark.long

MM_PER_PX = 0.0325
SHAPE = (480, 480)
MIDDLE = 240 * MM_PER_PX


def skin(pattern: str, seed: int = 0) -> FingerprintTexture:
    return FingerprintTexture(pattern=pattern, centre=(MIDDLE, MIDDLE), seed=seed)


def ridge_image(pattern: str, seed: int = 0) -> Tensor:
    return texture_image(skin(pattern, seed).ridges, SHAPE, MM_PER_PX)[0, 0]


def winding(image: Tensor, centre: tuple[float, float], radius: float) -> float:
    """Return the number of turns of the ridge direction along a circle (mm), by the structure tensor of the image."""
    down, right = (part.numpy() for part in torch.gradient(image))
    xx, xy, yy = (cv2.GaussianBlur(part, (0, 0), 9) for part in (right * right, right * down, down * down))
    around = np.linspace(0, 2 * math.pi, 400)
    columns = np.rint((centre[0] + radius * np.cos(around)) / MM_PER_PX).astype(int)
    rows = np.rint((centre[1] + radius * np.sin(around)) / MM_PER_PX).astype(int)
    double_angle = np.arctan2(2 * xy, xx - yy)[rows, columns]
    return float(np.unwrap(double_angle)[-1] - np.unwrap(double_angle)[0]) / (4 * math.pi)


@pytest.mark.parametrize(("pattern", "turns"), [("loop", 0.5), ("whorl", 1.0), ("arch", 0.0)])
def test_ridges_turn_around_the_core_as_in_a_print(pattern: str, turns: float) -> None:
    assert winding(ridge_image(pattern), (MIDDLE, MIDDLE), 2.5) == pytest.approx(turns, abs=0.05)
