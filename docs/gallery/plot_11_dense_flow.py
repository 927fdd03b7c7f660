"""
How does every pixel move?
==========================

Points suffice for medians and maps. Dense flow gives the motion of every pixel, also on ridges that repeat every ten
pixels, where a larger step than half a ridge is ambiguous.
"""

import matplotlib.pyplot as plt
import torch

from fingerflow import ops

y, x = torch.meshgrid(torch.arange(160.0), torch.arange(200.0), indexing="ij")
u = 1.5 * torch.sin(x / 60) * torch.cos(y / 50)
v = torch.cos(x / 45) * torch.sin(y / 40)


def ridges(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """Return the light of rings of ridges 10 px apart with pores, for positions in px."""
    pores = torch.sin(x * 0.83 + 2) * torch.sin(y * 0.71 + 1)
    return 128 + 60 * torch.cos(2 * torch.pi * torch.hypot(x + 40, y + 30) / 10) + 20 * pores


# %%
# The first frame shows at each pixel the skin that lies at x + u(x) in the second one: the flow of the first frame's
# pixels is then exactly (u, v).

noise = torch.Generator().manual_seed(0)
first, second = ridges(x + u, y + v), ridges(x, y)
first, second = (frame + 2 * torch.randn(frame.shape, generator=noise) for frame in (first, second))
flow = ops.dense_flow(first[None, None], second[None, None])
found_u, found_v = flow.displacement[0]
inner = (slice(10, -10), slice(10, -10))
error = torch.hypot(found_u - u, found_v - v)[inner]
print(f"error {error.nanmedian():.3f} px (median), {float(error.square().nanmean().sqrt()):.3f} px RMS")
assert error.nanmedian() < 0.03

_, axes = plt.subplots(1, 2, figsize=(8, 3), layout="constrained")
for panel, values, title in zip(
    axes, (found_u, torch.hypot(found_u - u, found_v - v)), ("u (px)", "error (px)"), strict=True
):
    figure = panel.imshow(values)
    panel.set_title(title)
    panel.figure.colorbar(figure, ax=panel)
