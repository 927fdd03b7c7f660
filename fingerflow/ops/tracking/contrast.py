"""Contrast of ridges in the topographic view: background subtraction, contrast stretching, unsharp masking."""

import kornia.filters
import torch
from torch import Tensor

from fingerflow.ops.filters.quantile import frame_quantile


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
    _check(frames)
    if background.shape[1:] != frames.shape[1:] or background.shape[0] not in (1, frames.shape[0]):
        raise ValueError(
            f"background has shape {tuple(background.shape)} beside frames of {tuple(frames.shape)}: give one frame of "
            "the same size, or one for each"
        )
    precision = torch.promote_types(_precision(frames), _precision(background))
    return frames.to(precision) - background.to(precision)


def stretch_contrast(frames: Tensor, lower: float = 0.01, upper: float = 0.99) -> Tensor:
    """Stretch each frame linearly so that its `lower` quantile becomes 0 and its `upper` quantile 1; clip beyond.

    Args:
        frames: (B, 1, H, W), integers of 8 to 32 bit or floating.
        lower, upper: fractions of the finite pixels, see `frame_quantile`.

    Returns:
        (B, 1, H, W) float32 (float64 for float64 input) within 0 and 1. A frame whose two quantiles are equal has no
        contrast to stretch and becomes 0. NaN stays NaN, infinities become 0 and 1.

    Raises:
        ValueError: not 0 <= lower < upper <= 1, or `frames` is not (B, 1, H, W).
    """
    _check(frames)
    if not 0 <= lower < upper <= 1:
        raise ValueError(
            f"quantiles {lower} and {upper}: contrast is stretched between two fractions, 0 <= lower < upper <= 1"
        )
    low, high = (frame_quantile(frames, fraction).reshape(-1, 1, 1, 1) for fraction in (lower, upper))
    precision = _precision(frames)
    values, low, span = frames.to(precision), low.to(precision), (high - low).to(precision)
    stretched = ((values - low) / torch.where(span > 0, span, 1.0)).clamp(0, 1)
    return torch.where((span > 0) | values.isnan(), stretched, 0.0)


def unsharp_mask(frames: Tensor, sigma: float, amount: float = 1.0) -> Tensor:
    """Return frames + amount (frames - blurred frames): details smaller than `sigma` grow by a factor of 1 + amount.

    Args:
        frames: (B, 1, H, W), integers of 8 to 16 bit or floating.
        sigma: standard deviation of the Gaussian blur in pixels, truncated at 4 sigma; the border is replicated.
        amount: gain of the detail; 0 leaves the frame as it is.

    Returns:
        (B, 1, H, W) float32 (float64 for float64 input), not clipped. A NaN or infinite pixel invalidates all pixels
        within 4 sigma.

    Raises:
        ValueError: `sigma` is not positive, or `frames` is not (B, 1, H, W).
    """
    _check(frames)
    if not sigma > 0:
        raise ValueError(f"sigma is {sigma} px: the blur needs a positive width")
    values = frames.to(_precision(frames))
    if values.numel() == 0:
        return values
    length = 2 * round(4 * sigma) + 1
    blurred = kornia.filters.gaussian_blur2d(values, (length, length), (sigma, sigma), border_type="replicate")
    return values + amount * (values - blurred)


def _check(frames: Tensor) -> None:
    if frames.ndim != 4 or frames.shape[1] != 1:
        raise ValueError(f"frames have shape {tuple(frames.shape)}: give (B, 1, H, W)")


def _precision(frames: Tensor) -> torch.dtype:
    return torch.float64 if frames.dtype == torch.float64 else torch.float32
