"""Drawn frames of a contact: ridges within an ellipse, under uneven light, on an empty glass."""

import torch
from torch import Tensor


def contact_frames(
    batch: int, height: int, width: int, dtype: torch.dtype, lights: int = 1
) -> tuple[Tensor, Tensor, Tensor]:
    """Return frames (batch, 1, H, W), light and black (lights, 1, H, W).

    The contact grows from nothing, the lamp becomes brighter, and noise is two counts. One corner has no light, and
    floating frames hold pixels that are NaN or infinite.
    """
    y, x = torch.meshgrid(torch.arange(float(height)), torch.arange(float(width)), indexing="ij")
    generator = torch.Generator().manual_seed(height + width)
    light = (150 + 20 * torch.cos(x / 100 + torch.arange(float(lights))[:, None, None]))[:, None]
    light[..., : height // 8, : width // 8] = 0
    black = 4 + torch.rand(lights, 1, height, width, generator=generator)
    radius = torch.hypot((x - 0.5 * width) / (0.4 * width), (y - 0.45 * height) / (0.4 * height))
    frames = []
    for k in range(batch):
        inside = torch.sigmoid(40 * (k / max(1, batch - 1) - radius))
        ridges = torch.sigmoid(4 * torch.sin(0.45 * (x + 0.3 * y)))
        passed = (1 + 0.02 * k) * (1 - 0.08 * inside - 0.4 * inside * ridges)
        frames.append(black[k % lights] + light[k % lights] * passed)
    counts = torch.stack(frames) if frames else torch.empty(0, 1, height, width)
    counts = (counts + 2 * torch.randn(counts.shape, generator=generator)).clamp(0, 255)
    if dtype.is_floating_point:
        counts[..., height // 2, ::7] = torch.nan
        counts[..., ::9, width // 3] = torch.inf
        return counts.to(dtype), light, black
    return counts.round().to(torch.int32).to(dtype), light, black
