"""Tests of the contact by Triton kernels against the portable form, in Triton's interpreter without a CUDA GPU."""

import math

import pytest
import torch
from torch import Tensor

from fingerflow.ops.contact.apparent_contact import apparent_contact
from fingerflow.ops.contact.contact_threshold import contact_threshold
from fingerflow.ops.contact.illumination_gain import illumination_gain
from fingerflow.ops.contact.real_contact_mask import real_contact_mask
from tests.kernels.fused import DEVICE, GPU_TILES, Fused

pytest.importorskip("triton", reason="Triton is not installed: pip install fingerflow-engine[gpu]")
pytestmark = pytest.mark.usefixtures("tiles")


def patterned(height: int, width: int, x: float, y: float, radius: float, period: float) -> Tensor:
    """Return a mask (H, W) of stripes in an ellipse, with a hole and a smaller patch beside it; a period of 0 makes
    the contact solid.
    """
    down, along = torch.meshgrid(torch.arange(height) - 1.0 * y, torch.arange(width) - 1.0 * x, indexing="ij")
    inside = torch.hypot(along / 1.3, down) < radius
    inside &= torch.hypot(along - 3, down + 2) > 0.15 * radius
    inside |= torch.hypot(along + x - 8, down + y - 8) < 6
    if period:
        inside &= ((along * math.cos(0.4) + down * math.sin(0.4)) / period) % 1 < 0.6
    return inside


LONG = pytest.mark.long  # the interpreter takes seconds
MASKS = {
    "stripes, solid and none": (
        2,
        lambda: [patterned(66, 75, 40, 35, 24, 5), patterned(66, 75, 40, 33, 20, 0), torch.zeros(66, 75)],
    ),
    "at the border": (8, lambda: [patterned(96, 131, 110, 10, 60, 15)]),
    "long and upright, alike on both sides": (2, lambda: [upright(90, 61, 8, 1), upright(90, 61, 8, 4)]),
    "ridges below the least share": (4, lambda: [upright(90, 90, 40, 24)]),
    "many tiles": (8, lambda: [patterned(512, 640, 330, 250, 170, 15)]),
}


def upright(height: int, width: int, half: int, period: int) -> Tensor:
    """Return a mask (H, W) of rows, every `period`-th one, that reach `half` px to both sides of the middle column."""
    mask = torch.zeros(height, width, dtype=torch.bool)
    mask[12 : height - 12 : period, width // 2 - half : width // 2 + half + 1] = True
    return mask


@pytest.mark.parametrize("name", [pytest.param(one, marks=() if one == "at the border" else LONG) for one in MASKS])
def test_apparent_contact(name: str, fused: Fused) -> None:
    """Regions, areas and ellipses agree for patterns with holes, beside smaller ones, at the border, and for none."""
    radius, masks = MASKS[name]
    mask = torch.stack([one.bool() for one in masks()])[:, None].to(DEVICE)
    expected = apparent_contact(mask, radius)
    fused()
    found = apparent_contact(mask, radius)
    assert (expected.area_px > 1000).any()
    for one, other, field in zip(found, expected, expected._fields, strict=True):
        # Sums in another order; a rounded limit moves the area of a region by its border.
        tolerance = {"density_margin": 2e-5, "covered_px": 0, "angle": 1e-3}.get(field, 0.01)
        if field == "angle":  # that of an upright ellipse may be pi / 2 or - pi / 2
            one, other = (torch.stack((torch.cos(2 * angle), torch.sin(2 * angle))) for angle in (one, other))
        torch.testing.assert_close(one, other, rtol=1e-4, atol=tolerance, equal_nan=True)


def lit_frames(kind: torch.dtype, height: int = 70, width: int = 107) -> tuple[Tensor, Tensor, Tensor]:
    """Return frames (B, 1, H, W) with a contact, of other light, full of contact and blank, with light and black level;
    a corner of the glass is not lit.
    """
    random = torch.Generator().manual_seed(1)
    levels = 200.0 if kind == torch.uint8 else 3000.0
    down, along = torch.meshgrid(torch.arange(height) / height, torch.arange(width) / width, indexing="ij")
    light = levels * (0.7 + 0.2 * down - 0.1 * along)
    light[:9, :12] = 0
    black = 5 + torch.rand(height, width, generator=random)
    contact = patterned(height, width, 80, 40, 22, 6)
    many = [(contact, 0.9), (contact, 1.1), (patterned(height, width, 50, 30, 200, 6), 1.0), (contact & False, 0.0)]
    shown = torch.stack([gain * light * (1 - 0.4 * one) + black for one, gain in many])[:, None]
    shown = shown + 0.005 * levels * torch.randn(shown.shape, generator=random)
    shown = shown.clamp_min(0).round() if kind != torch.float32 else shown
    if kind == torch.float32:
        shown[0, 0, 30, 20:25] = torch.nan
        shown[1, 0, 2, 40] = torch.inf
    return tuple(one.to(DEVICE) for one in (shown.to(kind), light[None, None], black[None, None]))


@pytest.mark.parametrize(
    ("kind", "tiles"),
    [
        (torch.uint8, ""),
        *(pytest.param(one, "", marks=LONG) for one in (torch.int32, torch.float32)),
        pytest.param(torch.uint8, GPU_TILES, marks=LONG),
    ],
    indirect=["tiles"],
)
def test_gain_and_mask(kind: torch.dtype, fused: Fused) -> None:
    """Gains and masks agree for 8 bit, 16 bit (as int32) and floating frames, with one light or one each."""
    frames, light, black = lit_frames(kind)
    limit = torch.tensor([0.7, 0.8, torch.nan, 2.0], device=DEVICE)
    each = light.expand(len(frames), -1, -1, -1)

    def both(light: Tensor) -> tuple[Tensor, ...]:
        gain = illumination_gain(frames, light, black)
        return gain, *(real_contact_mask(frames, light, black, limit, size) for size in (1, 3, 5))

    expected = both(light)
    fused()
    for found in (both(light), both(each)):
        torch.testing.assert_close(found[0], expected[0], rtol=1e-6, atol=0, equal_nan=True)
        for one, other in zip(found[1:], expected[1:], strict=True):
            torch.testing.assert_close(one, other, rtol=0, atol=0)
    assert expected[0][:2].tolist() == pytest.approx([0.9, 1.1], rel=0.02)
    assert expected[0][3].isnan()
    assert 100 < expected[2][0].sum() < frames[0].numel() / 2


def test_saturated_pixels(fused: Fused) -> None:
    """A saturated byte is not in contact in either form, even where light and black level together exceed 255."""
    frames = torch.full((1, 1, 12, 40), 255, dtype=torch.uint8, device=DEVICE)
    frames[..., 20:] = 254
    light = torch.full((1, 1, 12, 40), 250.0, device=DEVICE)
    black, limit = torch.full_like(light, 5.5), torch.ones(1, device=DEVICE)
    expected = real_contact_mask(frames, light, black, limit, 3)
    fused()
    found = real_contact_mask(frames, light, black, limit, 3)
    torch.testing.assert_close(found, expected, rtol=0, atol=0)
    assert found[..., 21:].all()
    assert not found[..., :19].any()


def thin_ridges(cover: float, kind: torch.dtype) -> tuple[Tensor, Tensor, Tensor]:
    """Return a frame (1, 1, H, W) of straight ridges, 13 px apart, that cover a share of an ellipse and are blurred by
    half a pixel, with the light and the black level of the glass.
    """
    y, x = torch.meshgrid(torch.arange(120.0), torch.arange(160.0), indexing="ij")
    across = (x * math.cos(0.3) + y * math.sin(0.3)) % 13 - 6.5
    ridge = (torch.erf((across + 6.5 * cover) / 0.7) - torch.erf((across - 6.5 * cover) / 0.7)) / 2
    inside = torch.sigmoid(4 * (45 - torch.hypot((x - 78) / 1.3, y - 58)))
    noise = torch.randn(120, 160, generator=torch.Generator().manual_seed(1))
    levels = 200.0 if kind == torch.uint8 else 3000.0
    shown = levels * (1 - inside * (0.1 + 0.55 * ridge)) + 5 + 0.004 * levels * noise
    light = torch.full((1, 1, 120, 160), levels)
    return tuple(one.to(DEVICE) for one in (shown.round().to(kind)[None, None], light, torch.full_like(light, 5.0)))


@pytest.mark.parametrize(
    ("cover", "kind"),
    [
        (0.15, torch.uint8),
        *(pytest.param(cover, kind, marks=LONG) for cover in (0.12, 0.2, 0.45) for kind in (torch.uint8, torch.int32)),
    ],
)
def test_threshold_of_thin_ridges(cover: float, kind: torch.dtype, fused: Fused) -> None:
    """The threshold at the edges of ridges agrees, also where ridges are two pixels wide."""
    given = thin_ridges(cover, kind)
    settings = {"median_px": 1, "radius": 8, "stride_px": 1}
    expected = contact_threshold(*given, None, **settings)
    fused()
    found = contact_threshold(*given, None, **settings)
    torch.testing.assert_close(found, expected, rtol=0, atol=2e-4)
    # Half-way between valleys (0.1) and ridges (0.65).
    assert float(expected) == pytest.approx(0.375, abs=0.04)
