"""The empty glass to what every later frame is compared with."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.ops.filters.illumination import glass_light


class Light(NamedTuple):
    """What the empty glass and a threshold say of every pixel of B views.

    Attributes:
        light: (B, 1, H, W) counts that the lamp gives a pixel; 0 where the glass is not lit, where nothing touches.
        black: (B, 1, H, W) counts without light.
        limit: (B,) share of the light below which a pixel touches: 1 - threshold.
    """

    light: Tensor
    black: Tensor
    limit: Tensor


class LightGraph(nn.Module):
    """Empty glass, dark frame and threshold to `Light`: a pixel touches where it counts less than black + limit light.

    Args:
        precision: of the result.
    """

    def __init__(self, precision: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.precision = precision

    def forward(self, empty: Tensor, dark: Tensor | None, threshold: Tensor) -> Light:
        """(B, 1, H, W) counts, a frame or a mean of several, `dark` None or zeros where unknown; threshold (B,) share
        of intensity lost, NaN while unknown: nothing touches.
        """
        return Light(*glass_light(empty, dark, self.precision), 1 - threshold.to(self.precision))
