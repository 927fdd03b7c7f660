"""Quantiles of whole frames.

They are values of the inverse distribution function, without interpolation (Hyndman & Fan 1996, type 1). No compiled
twin.
"""

import torch
from torch import Tensor

from fingerflow.ops.checks import check_frames


def frame_quantile(frames: Tensor, fraction: float) -> Tensor:
    """Return a quantile of each frame: the smallest value not exceeded by at least `fraction` of the finite pixels.

    Args:
        frames: (B, 1, H, W) integers of 8 to 32 bit or floating.
        fraction: 0 to 1; 0 gives the smallest finite value, 1 the largest.

    Returns:
        (B,) float64, exactly one of the pixel values. NaN for a frame without a finite pixel.

    Raises:
        ValueError: `fraction` lies outside 0 to 1 or `frames` is not (B, 1, H, W).
    """
    if not 0 <= fraction <= 1:
        raise ValueError(f"fraction is {fraction}: a quantile needs a fraction from 0 to 1")
    check_frames(frames)
    if frames.shape[2:].numel() == 0:
        return torch.full(frames.shape[:1], torch.nan, dtype=torch.float64, device=frames.device)
    values = frames.flatten(1).double()
    finite = values.isfinite()
    number = finite.sum(1, keepdim=True)
    rank = (number.double() * fraction).ceil().long().clamp(1, values.shape[1])
    ordered = torch.where(finite, values, torch.inf).sort(dim=1).values
    return torch.where(number > 0, ordered.gather(1, rank - 1), torch.nan).squeeze(1)
