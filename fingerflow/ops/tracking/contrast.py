"""Contrast of ridges in the topographic view: background subtraction, contrast stretching, unsharp masking.

No compiled twin.
"""

import kornia.filters
import torch
from torch import Tensor

from fingerflow.ops.checks import check_frames, check_images
from fingerflow.ops.filters.quantile import frame_quantile

_QUANTILES = (0.01, 0.99)


def subtract_background(frames: Tensor, background: Tensor) -> Tensor:
    """Return frames - background as signed floating values, which do not wrap around zero as uint8 would.

    Args:
        frames: (B, 1, H, W), integers of 8 to 16 bit or floating.
        background: (1 or B, 1, H, W), the same view without a finger.

    Returns:
        (B, 1, H, W) float32 (float64 if an input is). Non-finite pixels stay non-finite.

    Raises:
        ValueError: the shapes of `frames` and `background` do not match.
    """
    check_images(frames, background=background)
    precision = torch.promote_types(_precision(frames), _precision(background))
    return frames.to(precision) - background.to(precision)


def stretch_contrast(frames: Tensor) -> Tensor:
    """Stretch each frame linearly to 0 at the 0.01 quantile and 1 at the 0.99 quantile, and clip values beyond.

    Args:
        frames: (B, 1, H, W), integers of 8 to 32 bit or floating. Only finite pixels count (`frame_quantile`).

    Returns:
        (B, 1, H, W) float32 (float64 for float64 input) within 0 and 1. A frame whose two quantiles are equal has no
        contrast to stretch and becomes 0. NaN stays NaN, infinities become 0 and 1.

    Raises:
        ValueError: `frames` is not (B, 1, H, W).
    """
    check_frames(frames)
    low, high = (frame_quantile(frames, fraction).reshape(-1, 1, 1, 1) for fraction in _QUANTILES)
    precision = _precision(frames)
    values, low, span = frames.to(precision), low.to(precision), (high - low).to(precision)
    stretched = ((values - low) / torch.where(span > 0, span, 1.0)).clamp(0, 1)
    return torch.where((span > 0) | values.isnan(), stretched, 0.0)


def unsharp_mask(frames: Tensor, sigma: float) -> Tensor:
    """Sharpen frames by adding their difference from a Gaussian blur, which doubles the contrast of fine details.

    Args:
        frames: (B, 1, H, W), integers of 8 to 16 bit or floating.
        sigma: standard deviation of the Gaussian blur in pixels, truncated at 4 sigma; the border is replicated.

    Returns:
        (B, 1, H, W) float32 (float64 for float64 input), not clipped. A NaN or infinite pixel invalidates all pixels
        within 4 sigma.

    Raises:
        ValueError: `sigma` is not positive, or `frames` is not (B, 1, H, W).
    """
    check_frames(frames)
    if not sigma > 0:
        raise ValueError(f"sigma is {sigma} px: the blur needs a positive width")
    values = frames.to(_precision(frames))
    if values.numel() == 0:
        return values
    length = 2 * round(4 * sigma) + 1
    blurred = kornia.filters.gaussian_blur2d(values, (length, length), (sigma, sigma), border_type="replicate")
    return values + (values - blurred)


def _precision(frames: Tensor) -> torch.dtype:
    return torch.float64 if frames.dtype == torch.float64 else torch.float32
