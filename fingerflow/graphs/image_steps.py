"""Modules from images to images, for containers of modules such as kornia's `ImageSequential`."""

import torch
from torch import Tensor, nn

from fingerflow.ops.filters.illumination import normalize_illumination
from fingerflow.ops.filters.median import median_filter
from fingerflow.ops.full_precision import without_autocast


class NormalizeIllumination(nn.Module):
    """Module that divides frames by the light of the empty glass (:func:`fingerflow.ops.normalize_illumination`).

    Args:
        reference: (1, 1, H, W), the empty glass, in camera counts.
        dark: the same without light; None for zero.
    """

    reference: Tensor
    dark: Tensor

    def __init__(self, reference: Tensor, dark: Tensor | None = None) -> None:
        super().__init__()
        self.register_buffer("reference", reference)
        self.register_buffer("dark", torch.zeros_like(reference) if dark is None else dark)

    @without_autocast
    def forward(self, frames: Tensor) -> Tensor:
        """Return the light (B, 1, H, W) of frames relative to the empty glass: 1 without contact, and where the glass
        is not lit.
        """
        return normalize_illumination(frames, self.reference, self.dark).frames


class MedianFilter(nn.Module):
    """Module that computes the exact median around each pixel (:func:`fingerflow.ops.median_filter`).

    Args:
        size: odd side of the window, px.
    """

    def __init__(self, size: int = 3) -> None:
        super().__init__()
        self.size = size

    @without_autocast
    def forward(self, frames: Tensor) -> Tensor:
        """Return the medians (B, 1, H, W) of frames, of the same dtype."""
        return median_filter(frames, self.size)
