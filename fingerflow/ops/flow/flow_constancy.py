"""What dense flow takes to be the same in both images: grey levels, or their gradient.

Light that changes from place to place (contact that grows under the skin, shadows, gloss) moves grey levels, and hardly
their gradient (Brox, Bruhn, Papenberg, Weickert, ECCV 2004, section 2). Both derivatives are then channels of the data
term in place of the image, multiplied by P / (2 pi): a wave of period P counts for what it did, longer ones for less,
shorter ones and noise for more.
"""

import math
from typing import Literal, get_args

import torch
from torch import Tensor
from torch.nn import functional

Constancy = Literal["brightness", "gradient"]

_PERIOD = 15.0  # px, of ridges
# Deviation of what white noise of both images leaves after the low-pass of the spline, over that of one.
LEFT_BY_NOISE = {"brightness": 0.42, "gradient": 0.84}
# Eigenvalues of J that noise alone has, over those of brightness.
NOISE_OF_TENSOR = {"brightness": 1.0, "gradient": 5.9}


def check_constancy(constancy: str) -> None:
    """Raises a ValueError unless it is one of the two."""
    if constancy not in get_args(Constancy):
        raise ValueError(f"constancy must be one of {get_args(Constancy)}, not {constancy!r}")


def channels(coefficients: Tensor, constancy: Constancy) -> Tensor:
    """Coefficients (C B, 1, H, W), channel after channel, of the splines of what is constant: central differences of
    those of the images (B, 1, H, W), which are the coefficients of the differences of their splines.
    """
    if constancy == "brightness":
        return coefficients
    wide = functional.pad(coefficients, (1, 1, 1, 1), mode="replicate")
    across, down = wide[..., 1:-1, 2:] - wide[..., 1:-1, :-2], wide[..., 2:, 1:-1] - wide[..., :-2, 1:-1]
    return _PERIOD / (4 * math.pi) * torch.cat((across, down))
