"""The contact by kernels of Triton against the portable form, in Triton's interpreter where there is no GPU of CUDA."""

import math

import pytest
import torch
from torch import Tensor

from fingerflow.ops.contact.apparent_contact import apparent_contact
from tests.kernels.fused import DEVICE, Fused

pytest.importorskip("triton", reason="Triton is not installed: pip install fingerflow-engine[gpu]")


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


MASKS = {
    "stripes, solid and none": (
        2,
        lambda: [patterned(66, 75, 40, 35, 24, 5), patterned(66, 75, 40, 33, 20, 0), torch.zeros(66, 75)],
    ),
    "at the border": (8, lambda: [patterned(96, 131, 110, 10, 60, 15)]),
}


@pytest.mark.parametrize("name", MASKS)
def test_apparent_contact(name: str, fused: Fused) -> None:
    """Frames whose sides are no multiple of a cell: patterns with holes, beside smaller ones, at the border, none."""
    radius, masks = MASKS[name]
    mask = torch.stack([one.bool() for one in masks()])[:, None].to(DEVICE)
    expected = apparent_contact(mask, radius)
    fused()
    found = apparent_contact(mask, radius)
    assert (expected.area_px > 1000).any()
    for one, other, field in zip(found, expected, expected._fields, strict=True):
        # Sums in another order; a rounded limit moves the area of a region by its border.
        tolerance = {"density_margin": 2e-5, "covered_px": 0, "angle": 1e-3}.get(field, 0.01)
        torch.testing.assert_close(one, other, rtol=2e-5, atol=tolerance, equal_nan=True, msg=lambda m: f"{field}: {m}")
