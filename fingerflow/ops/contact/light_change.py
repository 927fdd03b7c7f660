"""Change of light between two pictures of a surface, beside what is printed on it."""

import torch
from torch import Tensor
from torch.nn import functional

from fingerflow.ops.markers.markers import blur

_LEAST_SHARE = 0.1  # of the pixels around a cell that must show the surface


def light_change(frames: Tensor, rest: Tensor, hidden: Tensor, cell: int, scale: float) -> Tensor:
    """Relative change of light, (B, 1, h, w) on cells: log of the quotient of two pictures.

    The mean over the pixels that show the surface in both pictures, weighted by a Gaussian (normalised convolution,
    Knutsson & Westin 1993), less its median over the cells: that is the lamp's or the camera's gain. Where more than
    half of the view changes, the median is of what changes.

    Args:
        frames: (B, 1, H, W), 8 to 16 bit or floating.
        rest: (1, 1, H, W), the surface at rest.
        hidden: (B, 1, H, W) bool, where something printed covers it in either.
        cell: side of a cell, px; a last one that the border cuts is left out.
        scale: standard deviation of the Gaussian, px.

    Returns:
        float32; NaN where less than a tenth of the surface shows.
    """
    if frames.ndim != 4 or rest.shape[-2:] != frames.shape[-2:] or hidden.shape != frames.shape:
        raise ValueError(
            f"frames {tuple(frames.shape)}, rest {tuple(rest.shape)} and hidden {tuple(hidden.shape)}: "
            "give (B, 1, H, W), (1, 1, H, W) and (B, 1, H, W)"
        )
    # Half a grey level keeps black from being minus infinity.
    change = torch.log((frames.to(torch.float32) + 0.5) / (rest.to(torch.float32) + 0.5))
    shown = (~hidden).to(torch.float32)
    share = blur(functional.avg_pool2d(shown, cell), scale / cell)
    total = blur(functional.avg_pool2d(torch.where(hidden, 0.0, change), cell), scale / cell)
    mean = torch.where(share > _LEAST_SHARE, total / share.clamp_min(_LEAST_SHARE), torch.nan)
    return mean - mean.flatten(1).nanmedian(1).values[:, None, None, None]
