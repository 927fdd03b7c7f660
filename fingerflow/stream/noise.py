"""The noise of a view, in operations that export."""

import math

from torch import Tensor

from fingerflow.ops.noise import absolute_responses


def noise_variance(view: Tensor) -> Tensor:
    """Variance (B,) of white noise of floating views (B, 1, H, W), counts^2; as `ops.estimate_noise`."""
    mean = absolute_responses(view).mean((1, 2, 3))
    return (math.pi / 72) * mean * mean
