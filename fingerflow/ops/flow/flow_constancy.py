"""Constancy assumption of dense flow: the grey levels, or these and their gradients, are equal in both images.

Illumination changes that vary in space (contact that grows under the skin, shadows, gloss) alter grey levels, but
hardly their gradient (Brox, Bruhn, Papenberg, Weickert, ECCV 2004, section 2). Both derivatives, multiplied by
P / (2 pi), then join the image as channels of the data term, each of half the weight. A wave of period P weighs as
much as before, longer ones less, shorter ones and noise more.

No compiled twin.
"""

import math
from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional

Constancy = Literal["brightness", "both"]

_PERIOD = 15.0  # px, period of the ridges
# Standard deviation of the residual, after the low-pass of the spline, with white noise in both images; relative to the
# noise of one image.
LEFT_BY_NOISE = {"brightness": 0.42, "both": 0.66}
# Eigenvalues of J for noise alone, relative to those with brightness constancy.
NOISE_OF_TENSOR = {"brightness": 1.0, "both": 3.45}


def channels(coefficients: Tensor, constancy: Constancy) -> Tensor:
    """Return the channels of dense flow: spline coefficients (C B, 1, H, W) of the C quantities assumed constant.

    These are the grey level, or the grey level and the two components of its gradient. For the gradient they are
    central differences of the coefficients of the images (B, 1, H, W), which are the coefficients of the differences of
    their splines.
    """
    if constancy == "brightness":
        return coefficients
    wide = functional.pad(coefficients, (1, 1, 1, 1), mode="replicate")
    across, down = wide[..., 1:-1, 2:] - wide[..., 1:-1, :-2], wide[..., 2:, 1:-1] - wide[..., :-2, 1:-1]
    slopes = _PERIOD / (4 * math.pi) * torch.cat((across, down))
    return math.sqrt(0.5) * torch.cat((coefficients, slopes))
