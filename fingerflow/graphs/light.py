"""Reference light of the empty glass, with which every later frame is compared."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.ops.filters.illumination import glass_light


class Light(NamedTuple):
    """Light of the lamp per pixel and black level of B views, in camera counts, and the share of the light below which
    a pixel is in contact.

    Attributes:
        light: (B, 1, H, W) counts due to the lamp; 0 where the glass is not lit, and no contact is detected there.
        black: (B, 1, H, W) counts without light.
        limit: (B,) share of the light below which a pixel is in contact: 1 - threshold.
    """

    light: Tensor
    black: Tensor
    limit: Tensor


class LightGraph(nn.Module):
    """Module that computes the reference for contact detection: the light of the empty glass and the black level per
    pixel, and the limit, as a share of that light, below which a pixel is in contact.

    A pixel is in contact where its count is less than black + limit light.

    Args:
        precision: dtype of the result.
    """

    def __init__(self, precision: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.precision = precision

    def forward(self, empty: Tensor, dark: Tensor | None, threshold: Tensor) -> Light:
        """Compute the reference light from camera counts (B, 1, H, W) of the empty glass.

        Counts are those of one frame or the mean of several. `dark` is None or zeros where it is unknown. `threshold`
        (B,) is a relative intensity loss, NaN while it is unknown: then only pixels below `black` are in contact.
        """
        return Light(*glass_light(empty, dark, self.precision), 1 - threshold.to(self.precision))
