"""
Can a network learn from the divergence, through the tracker?
=============================================================

A lens that distorts makes a rigid plate seem to stretch as it moves. Here a small network learns to undo such a
distortion from nothing but that: it is trained until a plate that is shifted has no divergence. The loss is taken from
the divergence at the tracked points, and its gradient goes back through the plane fits, `track_points` and the
resampled pictures to the weights of the network; the tracker is differentiated at the solution of its fit, not through
its steps.
"""

import matplotlib.pyplot as plt
import torch
from torch import nn
from torch.nn import functional

from fingerflow import ops

SIDE, LENS, STEPS = 128, 6.0, 80  # px, and px by which the lens displaces the middle of an edge
torch.manual_seed(0)
y, x = torch.meshgrid(torch.arange(SIDE), torch.arange(SIDE), indexing="ij")
pixels = torch.stack((x, y), -1).float()
middle = (SIDE - 1) / 2
waves, phases = 0.35 * torch.randn(100, 2), 6.28 * torch.rand(100)


def photograph(stretch: torch.Tensor, shifts: torch.Tensor) -> torch.Tensor:
    """Return pictures (B, 1, H, W) of a plate that was stretched about the middle and then shifted (B, 2), through the
    lens and with a camera's noise; the pattern of the plate is a function, evaluated where each pixel looks.
    """
    away = pixels - middle
    glass = away * (1 + LENS / middle**3 * away.square().sum(-1, keepdim=True))
    plate = (glass - shifts[:, None, None]) / (1 + stretch)
    light = 128 + 12 * torch.cos(plate @ waves.T + phases).sum(-1)
    return (light + torch.randn_like(light)).clamp(0, 255)[:, None]


class Correction(nn.Module):
    """Network from a position to the displacement that undoes the lens there, by which it resamples pictures."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(2, 24), nn.Tanh(), nn.Linear(24, 2))
        nn.init.zeros_(self.layers[2].weight)

    def forward(self, pictures: torch.Tensor) -> torch.Tensor:
        """Return the pictures (B, 1, H, W) as they would be without the lens."""
        places = pixels / middle - 1
        grid = (places + 0.1 * self.layers(places)).expand(len(pictures), -1, -1, -1)
        return functional.grid_sample(pictures, grid, mode="bicubic", padding_mode="border", align_corners=True)


places = torch.linspace(20, SIDE - 21, 8).round()
points = torch.cartesian_prod(places, places)[None]


def measure(before: torch.Tensor, after: torch.Tensor, shifts: torch.Tensor) -> torch.Tensor:
    """Return the divergence (B, N) in µm/mm at the points between pictures before and after about this movement."""
    start = points.expand(len(before), -1, -1)
    tracks = ops.track_points(before, after, start, window=21, initial=start + shifts[:, None])
    return 1e3 * ops.divergence(ops.local_gradients(start, tracks.points - start, gauge_length=50.0).gradient)


# %%
# Six shifts of the plate in different directions, four pixels each. The truth that the network is trained on is that a
# rigid plate has a divergence of zero.

angles = torch.arange(6) * torch.pi / 3
shifts = 4 * torch.stack((angles.cos(), angles.sin()), -1)
still, shifted = photograph(0.0, 0 * shifts), photograph(0.0, shifts)
network = Correction()
optimiser = torch.optim.Adam(network.parameters(), lr=0.02)
losses = []
for _ in range(STEPS):
    optimiser.zero_grad()
    loss = measure(network(still), network(shifted), shifts).square().nanmean()
    loss.backward()
    optimiser.step()
    losses.append(loss.item() ** 0.5)
print(f"divergence of the shifted plate: {losses[0]:.1f} µm/mm RMS at first, {losses[-1]:.1f} at last")

# %%
# The test is a movement that the network has not seen: a plate stretched by 1.5 % in each direction and shifted, whose
# divergence is 30 µm/mm everywhere.

shift = torch.tensor([[3.0, 2.0]])
pair = photograph(0.0, 0 * shift), photograph(0.015, shift)
with torch.no_grad():
    found = {
        "through the lens": measure(*pair, shift)[0],
        "corrected by the network": measure(*map(network, pair), shift)[0],
    }
errors = {name: (one - 30).square().nanmean().sqrt().item() for name, one in found.items()}
print({name: f"{error:.1f} µm/mm" for name, error in errors.items()})
assert errors["through the lens"] > 10
assert errors["corrected by the network"] < 3

figure, (left, *maps) = plt.subplots(1, 3, figsize=(9.2, 2.8), layout="constrained", width_ratios=(1.1, 1, 1))
left.plot(losses)
left.set(xlabel="step", ylabel="RMS divergence of the shifted\nplate (µm/mm), truth 0", ylim=(0, None))
for axes, (name, one) in zip(maps, found.items(), strict=True):
    dots = axes.scatter(*points[0].T, c=one, s=80, marker="s", vmin=0, vmax=60, cmap="RdBu_r", edgecolors="0.8")
    axes.set(box_aspect=1, xticks=[], yticks=[])
    axes.set_title(f"{name},\n{errors[name]:.1f} µm/mm RMS off", fontsize=8)
figure.colorbar(dots, ax=maps, label="divergence (µm/mm), truth 30")
