"""
Can a network learn through the tracker?
========================================

`track_points` is differentiable: its gradient is that of the solution of the fit, not of its steps. So a measured
divergence can drive whatever makes the pictures. Here two numbers of a warp are learnt from the divergence that the
tracker finds, without the true displacements.
"""

import matplotlib.pyplot as plt
import torch
from torch.nn import functional

from fingerflow import ops

torch.manual_seed(0)
texture = functional.avg_pool2d(torch.rand(1, 1, 160, 160) * 255, 5, 1, 2)
points = ops.detect_corners(texture, count=80, min_distance=8, border=30).points


def warp(stretch: torch.Tensor) -> torch.Tensor:
    """Return the texture stretched about its centre by (1 + stretch) in x and y."""
    scale = torch.diag(1 / (1 + stretch)).unsqueeze(0)
    grid = functional.affine_grid(functional.pad(scale, (0, 1)), [1, 1, 160, 160], align_corners=True)
    return functional.grid_sample(texture, grid, mode="bicubic", align_corners=True, padding_mode="reflection")


def measure(stretch: torch.Tensor) -> torch.Tensor:
    """Return the tracked points' gradient of displacement, median over the points, as (du/dx, dv/dy)."""
    tracks = ops.track_points(texture, warp(stretch), points, window=21)
    found = tracks.status[0] == 0
    gradient = ops.local_gradients(points[:, found], (tracks.points - points)[:, found], gauge_length=200.0).gradient
    return torch.stack((gradient[..., 0, 0].nanmedian(), gradient[..., 1, 1].nanmedian()))


wanted = torch.tensor([0.02, -0.01])
stretch = torch.zeros(2, requires_grad=True)
optimiser = torch.optim.Adam([stretch], lr=3e-3)
losses = []
for _ in range(40):
    optimiser.zero_grad()
    loss = 1e6 * (measure(stretch) - wanted).square().sum()  # (µm/mm)²
    loss.backward()
    optimiser.step()
    losses.append(loss.item())

print(f"learnt {stretch.tolist()}, wanted {wanted.tolist()}")
assert (stretch.detach() - wanted).abs().max() < 2e-3

_, axes = plt.subplots(figsize=(4.5, 3), layout="constrained")
axes.semilogy(losses)
axes.set(xlabel="step", ylabel="squared error of the gradient ((µm/mm)²)")
