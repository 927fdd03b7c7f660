"""Tests of the illumination gain: skin little darker than glass, hardly any glass, and no glass."""

import math

import pytest
import torch
from torch import Tensor

from fingerflow.ops.contact.illumination_gain import illumination_gain

pytestmark = pytest.mark.usefixtures("each_form")

RIDGES_PX = 14.0


def glass(height: int, width: int) -> Tensor:
    """Return the uneven light of a lamp, (1, 1, H, W) counts."""
    y, x = torch.meshgrid(torch.linspace(-1, 1, height), torch.linspace(-1, 1, width), indexing="ij")
    return (200 - 60 * (x * x + 0.5 * y * y) + 20 * x)[None, None]


def kept(height: int, width: int, share: float, angle: float, valley: float) -> Tensor:
    """Return the share of light (1, 1, H, W) that remains where skin with ridges covers this share of the frame."""
    y, x = torch.meshgrid(torch.arange(height) - height / 2, torch.arange(width) - width / 2, indexing="ij")
    inside = torch.hypot(x / width, y / height) < math.sqrt(share / math.pi) if share < 1 else torch.ones_like(x) > 0
    ridge = torch.cos(2 * math.pi / RIDGES_PX * (x * math.cos(angle) + y * math.sin(angle))) > 0
    return torch.where(inside, torch.where(ridge, 0.5, 1 - valley), 1.0)[None, None]


def frame(light: Tensor, share: Tensor, gain: float, noise: float = 2.0, seed: int = 0) -> Tensor:
    counts = 6 + gain * light * share + noise * torch.randn(light.shape, generator=torch.Generator().manual_seed(seed))
    return counts.round().clamp(0, 255).to(torch.uint8)


@pytest.mark.parametrize("shape", [(224, 280)])
@pytest.mark.parametrize("gain", [0.8, 0.97, 1.2])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.9])
def test_gain_is_that_of_the_glass(shape: tuple[int, int], gain: float, share: float) -> None:
    """The gain is found to 0.3 %, even if few blocks show glass; skin between ridges transmits 98 % of the light and is
    not mistaken for glass.
    """
    light = glass(*shape) * 0.9
    for angle in (0.0, 0.7, math.pi / 2):
        view = frame(light, kept(*shape, share, angle, 0.02), gain)
        assert float(illumination_gain(view, light, torch.full_like(light, 6.0))) == pytest.approx(gain, rel=0.003)


@pytest.mark.parametrize("angle", [0.0, 0.7, math.pi / 2])
@pytest.mark.parametrize("valley", [0.02, 0.1])
def test_no_glass_no_gain(angle: float, valley: float) -> None:
    light = glass(512, 640)
    for gain in (0.8, 1.0, 1.2):
        view = frame(light * 0.9, kept(512, 640, 1.0, angle, valley), gain)
        assert illumination_gain(view, light * 0.9, torch.full_like(light, 6.0)).isnan().all()


def test_hard_frames_have_no_gain() -> None:
    """Blank, saturated and NaN frames have no gain; neither have frames whose light changed so far that the change
    could be contact.
    """
    light = glass(128, 160)
    black = torch.zeros_like(light)
    frames = torch.cat([0 * light, 0 * light + 2000, light * torch.nan, 0.5 * light, 1.6 * light])
    assert illumination_gain(frames, light, black).isnan().all()
    assert illumination_gain(light, 0 * light, black).isnan().all()
    broken = light.clone()
    broken[..., 30:60, 40:90] = torch.nan
    assert float(illumination_gain(broken, light, black)) == pytest.approx(1, abs=1e-5)
