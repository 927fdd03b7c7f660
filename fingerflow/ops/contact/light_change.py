"""Relative brightness change between two images of a surface, excluding printed markers."""

import torch
from torch import Tensor
from torch.nn import functional

from fingerflow.ops.markers.markers import blur

_LEAST_SHARE = 0.1  # least share of the pixels around a cell that must show the surface and no marker


def light_change(frames: Tensor, rest: Tensor, hidden: Tensor, cell: int, scale: float) -> Tensor:
    """Return the relative brightness change (B, 1, h, w), in cells of `cell` px, of images of a surface since rest
    (unloaded): the logarithm of their quotient, averaged over the pixels that no marker hides.

    The change is the logarithm of the quotient of both images. The logarithm is averaged with Gaussian weights over the
    pixels that show the surface in both images (normalised convolution, Knutsson & Westin 1993). The median over the
    cells, the gain of lamp or camera, is subtracted. Where more than half of the view changes, that median contains the
    change itself.

    Args:
        frames: (B, 1, H, W), 8 to 16 bit or floating.
        rest: (1, 1, H, W), the surface at rest.
        hidden: (B, 1, H, W) bool, where a printed marker covers the surface in either image.
        cell: side of a cell, px; cells cut by the border are left out.
        scale: standard deviation of the Gaussian, px.

    Returns:
        float32; NaN where less than a tenth of the surface is visible.
    """
    one = (1, *frames.shape[1:])
    if frames.ndim != 4 or one[:2] != (1, 1) or rest.shape != one or hidden.shape != frames.shape:
        raise ValueError(
            f"frames {tuple(frames.shape)}, rest {tuple(rest.shape)} and hidden {tuple(hidden.shape)}: "
            "give (B, 1, H, W), (1, 1, H, W) and (B, 1, H, W)"
        )
    # Half a grey level is added so that the logarithm of black is finite.
    change = torch.log((frames.to(torch.float32) + 0.5) / (rest.to(torch.float32) + 0.5))
    shown = (~hidden).to(torch.float32)
    share = blur(functional.avg_pool2d(shown, cell), scale / cell)
    total = blur(functional.avg_pool2d(torch.where(hidden, 0.0, change), cell), scale / cell)
    mean = torch.where(share > _LEAST_SHARE, total / share.clamp_min(_LEAST_SHARE), torch.nan)
    return mean - mean.flatten(1).nanmedian(1).values[:, None, None, None]
