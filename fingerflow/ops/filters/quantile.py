"""Quantiles of whole frames, computed by counting pixels instead of sorting them."""

import torch
from torch import Tensor

from fingerflow.ops.checks import check_frames
from fingerflow.ops.contact.otsu import histogram

_HALVINGS = 24


def frame_quantile(frames: Tensor, fraction: float) -> Tensor:
    """Return a quantile of each frame: the smallest value not exceeded by at least `fraction` of the finite pixels.

    The quantile of uint8 is read from the histogram. For other dtypes a bisection counts the pixels up to the middle of
    the interval that contains the value.

    Args:
        frames: (B, 1, H, W) integers of 8 to 32 bit or floating.
        fraction: 0 to 1; 0 gives the smallest finite value, 1 the largest.

    Returns:
        (B,) float64. For integers of up to 16 bit it is exactly one of the pixel values. For other dtypes it may exceed
        the exact quantile by 2^-24 of the frame's range. NaN for a frame without a finite pixel.

    Raises:
        ValueError: `fraction` lies outside 0 to 1 or `frames` is not (B, 1, H, W).
    """
    if not 0 <= fraction <= 1:
        raise ValueError(f"fraction is {fraction}: a quantile needs a fraction from 0 to 1")
    check_frames(frames)
    if frames.shape[2:].numel() == 0:
        return torch.full(frames.shape[:1], torch.nan, dtype=torch.float64, device=frames.device)
    if frames.dtype == torch.uint8:
        return _histogram_quantile(histogram(frames), fraction)
    return _halving_quantile(frames.flatten(1), fraction)


def _histogram_quantile(counts: Tensor, fraction: float) -> Tensor:
    rank = (counts.sum(1, keepdim=True).double() * fraction).ceil().clamp(min=1)
    return (counts.cumsum(1) < rank).sum(1).double()


def _halving_quantile(values: Tensor, fraction: float) -> Tensor:
    whole = not values.is_floating_point()
    if values.dtype not in (torch.float32, torch.float64):
        values = values.to(torch.int32) if whole else values.float()
    finite = values.isfinite()
    present = finite.sum(1, keepdim=True)
    rank = (present.double() * fraction).ceil().clamp(min=1)
    lowest = torch.where(finite, values, torch.inf).amin(1, keepdim=True).double()
    high = torch.where(finite, values, -torch.inf).amax(1, keepdim=True).double()
    # Replace non-finite pixels by infinity, so that they never count as below a limit.
    counted = values if whole else torch.where(finite, values, torch.inf)

    def enough(limit: Tensor) -> Tensor:
        return (counted <= limit.to(counted.dtype)).sum(1, keepdim=True) >= rank

    low = lowest - 1 if whole else lowest
    for _ in range(_HALVINGS):
        middle = low + (high - low) / 2
        middle = middle.floor() if whole else middle
        reached = enough(middle)
        low, high = torch.where(reached, low, middle), torch.where(reached, middle, high)
    if not whole:  # the bisection approaches the smallest value only from above
        high = torch.where(enough(lowest), lowest, high)
    return torch.where(present > 0, high, torch.nan).squeeze(1)
