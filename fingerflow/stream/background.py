"""What the empty glass says about every later frame, computed once."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.ops.illumination import LEVEL_RANGE, levels_per_unit
from fingerflow.stream.finite import finite
from fingerflow.stream.levels import LEVELS

_LEAST_LIGHT = 0.05  # of full light at which a quotient means anything, as in `normalize_illumination`
_STEP = 4  # px between the pixels that tell full light


class Background(NamedTuple):
    """All (B, 1, H, W).

    Attributes:
        gain, offset: level of light lost = offset - gain * count, rounded and kept within 0 to 255 (`ops.quantize`).
        valid: uint8, 1 where the glass is lit.
        limit: counts below which a pixel has lost more light than the threshold; 0 where it cannot. Type of the frames
            if that is uint8, else float.
    """

    gain: Tensor
    offset: Tensor
    valid: Tensor
    limit: Tensor


class BackgroundStep(nn.Module):
    """Light of the empty glass, and a threshold, to the numbers that the other steps compare counts with.

    With s levels a unit of light lost, gain is s / (background - dark) and offset s (1 - low) + gain * dark. Where the
    glass is not lit, gain is 0 and the level that of no contact.

    Args:
        frames: type of the frames, uint8 or uint16; the background may be a mean of several.
    """

    def __init__(self, frames: torch.dtype = torch.uint8, precision: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.frames = frames
        self.precision = precision

    def forward(self, background: Tensor, dark: Tensor, threshold: Tensor) -> Background:
        """(B, 1, H, W) counts, `dark` zeros where unknown; threshold (B,) share of light lost, NaN while unknown."""
        low, high = LEVEL_RANGE
        scale = levels_per_unit(low, high)
        black = dark.to(self.precision)
        light = background.to(self.precision) - black
        # The 0.99 quantile of a lattice: reflections and hot pixels stand above it.
        some = light[..., ::_STEP, ::_STEP].flatten(1)
        above = max(1, some.shape[1] // 100)
        full = some.topk(above, dim=1).values[:, -1].reshape(-1, 1, 1, 1)
        lit = (light > 0) & (light > _LEAST_LIGHT * full)
        gain = torch.where(lit, scale / torch.where(lit, light, 1.0), 0.0)
        offset = torch.where(lit, -low * scale + scale, -low * scale) + gain * black
        whole = whole_level(threshold.to(self.precision)).reshape(-1, 1, 1, 1)
        most = 255.0 if self.frames == torch.uint8 else 65535.0
        # Solved for the count, then tried: rounding must decide here as it does on levels.
        near = ((offset - whole - 0.5) / torch.where(lit, gain, 1.0)).floor()
        limit = torch.zeros_like(near)
        for step in (-1, 0, 1):
            count = (near + step).clamp_min(0.0).clamp_max(most - 1)
            limit = torch.where(lit & (levels(count, gain, offset) > whole), count + 1, limit)
        kept = limit.to(torch.uint8) if self.frames == torch.uint8 else limit
        return Background(gain, offset, lit.to(torch.uint8), kept)


def levels(counts: Tensor, gain: Tensor, offset: Tensor) -> Tensor:
    """Light lost of floating counts, in levels 0 to 255."""
    return (offset - counts * gain).clamp(0, LEVELS - 1).round()


def whole_level(threshold: Tensor) -> Tensor:
    """The level (B,) that a level must exceed to exceed the threshold, share of light lost; 255 for NaN."""
    low, high = LEVEL_RANGE
    limit = (threshold - low) * levels_per_unit(low, high)
    return torch.where(finite(limit), limit, float(LEVELS)).floor().clamp(0, LEVELS - 1)
