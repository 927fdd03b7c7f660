"""How alike the windows around points are in two pictures, one of them deformed: a second opinion on tracked points.

Nothing of it is the tracker's: samples are Keys' cubic convolution of the recorded pixels (1981), not a spline's, the
deformation is given, and nothing is searched for.
"""

import torch
from torch import Tensor
from torch.nn import functional

_LEAST_VARIANCE = 1e-12


def sample_windows(images: Tensor, number: Tensor, places: Tensor, warp: Tensor, window: int, step: int) -> Tensor:
    """Grey levels in deformed windows.

    Args:
        images: (n, 1, H, W).
        number: (N,) int64, in which of them each window lies.
        places: (N, 2) px, middles.
        warp: (N, 2, 2), by which the steps of the grid of a window are deformed.
        window, step: px, side of a window and steps of its grid.

    Returns:
        (N, m) of the dtype of the places; NaN where a window does not lie in the image.
    """
    reach = window // 2
    offsets = torch.arange(-reach, reach + 1, step, dtype=places.dtype, device=places.device)
    y, x = torch.meshgrid(offsets, offsets, indexing="ij")
    grid = places[:, None] + torch.stack((x.flatten(), y.flatten()), -1) @ warp.transpose(1, 2)
    height, width = images.shape[-2:]
    size = torch.tensor([width - 1, height - 1], dtype=places.dtype, device=places.device)
    found = grid.new_full(grid.shape[:2], torch.nan)
    whole = ((grid >= 1) & (grid <= size - 1)).all(-1).all(-1)  # false where a place is NaN
    for frame in number[whole].unique():
        chosen = (whole & (number == frame)).nonzero().squeeze(1)
        where = (2 * grid[chosen] / size - 1)[None]
        image = images[frame : frame + 1].to(places.dtype)
        found[chosen] = functional.grid_sample(image, where, mode="bicubic", align_corners=True)[0, 0]
    return found


def correlation(one: Tensor, other: Tensor) -> Tensor:
    """Normalised correlation (N,) of windows (N, m): whatever gain and offset of the light; NaN where one is blank."""
    first, second = (part - part.mean(1, keepdim=True) for part in (one, other))
    variances = first.square().mean(1) * second.square().mean(1)
    found = (first * second).mean(1) / variances.clamp_min(_LEAST_VARIANCE).sqrt()
    return torch.where(variances > _LEAST_VARIANCE, found, torch.nan)
