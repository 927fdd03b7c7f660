"""The noise of a view, in operations that export."""

import math

from torch import Tensor

from fingerflow.ops.noise import row_step


def noise_variance(view: Tensor) -> Tensor:
    """Variance (B,) of white noise of floating views (B, 1, H, W), counts^2; as `ops.estimate_noise`."""
    step = row_step(view.shape[-2])
    bent = view[..., :-2:step, :] - 2 * view[..., 1:-1:step, :] + view[..., 2::step, :]
    bent = bent[..., :-2] - 2 * bent[..., 1:-1] + bent[..., 2:]
    mean = bent.abs().mean((1, 2, 3))
    return (math.pi / 72) * mean * mean
