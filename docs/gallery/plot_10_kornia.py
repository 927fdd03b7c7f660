"""
In a kornia pipeline
====================

Ops take kornia's images `(B, 1, H, W)` and points `(B, N, 2)` as (x, y) px, with whole numbers at pixel centres. So an
augmentation of kornia moves frames and points alike, and a median filter of ours is a step of kornia's sequence.
"""

import matplotlib.pyplot as plt
import torch
from kornia.augmentation import AugmentationSequential, RandomAffine
from kornia.filters import GaussianBlur2d
from torch import nn
from torch.nn import functional

from fingerflow import ops


class Median(nn.Module):
    """A median filter of 3 x 3 pixels as a module."""

    def forward(self, frames: torch.Tensor) -> torch.Tensor:
        """Return the filtered frames (B, 1, H, W)."""
        return ops.median_filter(frames, 3)


torch.manual_seed(0)
frames = functional.avg_pool2d(torch.rand(2, 1, 160, 160), 5, 1, 2)
clean = nn.Sequential(GaussianBlur2d((3, 3), (0.5, 0.5)), Median())(frames)
points = ops.detect_corners(255 * clean, count=60, min_distance=8, border=35).points

# %%
# The augmentation moves frames and points by the same random affine map; the tracker should find the points where the
# map puts them.

augment = AugmentationSequential(
    RandomAffine(degrees=3.0, translate=(0.02, 0.02), p=1.0), data_keys=["input", "keypoints"]
)
moved, true = augment(clean, points)
tracks = ops.track_points(255 * clean, 255 * moved, points, window=21, search=8)
found = tracks.status == 0
error = (tracks.points - true).norm(dim=-1)[found]
print(f"{int(found.sum())} of {found.numel()} points found, median error {error.median():.3f} px")
assert found.float().mean() > 0.8
assert error.median() < 0.05

_, axes = plt.subplots(1, 2, figsize=(7, 3.4), layout="constrained")
for panel, image, at in zip(axes, (clean, moved), (points, tracks.points), strict=True):
    panel.imshow(image[0, 0], cmap="gray")
    panel.plot(*at[0][found[0]].T, ".", color="tab:orange")
    panel.axis("off")
