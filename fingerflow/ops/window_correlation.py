"""How alike the windows around points are in two pictures, one of them deformed: a second opinion on tracked points.

Nothing of it is the tracker's: samples are Keys' cubic convolution of the recorded pixels (1981), not a spline's, the
deformation is given, and nothing is searched for.
"""

import math

import torch
from torch import Tensor
from torch.nn import functional

from fingerflow import kernels

_LEAST_VARIANCE = 1e-12
_ROUNDS = 4
_BESIDE = 0.5  # px, over which a slope is taken
_FARTHEST = 0.15  # by which a round may change a number of a deformation


def sample_windows(images: Tensor, number: Tensor, places: Tensor, warp: Tensor, window: int, step: int) -> Tensor:
    """Grey levels in deformed windows.

    Args:
        images: (n, 1, H, W).
        number: (N,) int64, in which of them each window lies.
        places: (N, 2) px, middles.
        warp: (N, 2, 2), by which the steps of the grid of a window are deformed.
        window, step: px, side of a window and steps of its grid.

    Returns:
        (N, m) of the dtype of the places; NaN where a window does not lie in the image, a pixel around it left out.
    """
    known = kernels.serve(images, number, places, warp) and images.dtype in kernels.FRAME_KINDS
    if known and places.dtype == torch.float32 and min(images.shape[-2:]) >= 4:
        return kernels.sample_windows(images, number, places, warp, window, step)
    steps = _steps(window, step, places)
    height, width = images.shape[-2:]
    size = torch.tensor([width - 1, height - 1], dtype=places.dtype, device=places.device)
    # A deformed square lies in the image where its corners do; false where a place is NaN.
    side = math.isqrt(len(steps))
    corners = steps[[0, side - 1, side * (side - 1), side * side - 1]].expand(len(places), -1, -1)
    at = torch.baddbmm(places[:, None], corners, warp.transpose(1, 2))
    whole = ((at >= 1) & (at <= size - 1)).flatten(1).all(1)
    # All grids by one product, (N, 2, m), in the units of `grid_sample`, -1 to 1 from edge to edge: a product for each
    # window takes ten times as long.
    half = size / 2
    affine = torch.cat((warp / half[:, None], (places / half - 1)[..., None]), 2)
    straight = torch.cat((steps, torch.ones_like(steps[:, :1])), 1)
    grid = (affine.flatten(0, 1) @ straight.T).unflatten(0, (len(places), 2))
    found = places.new_full((len(places), len(steps)), torch.nan)
    for frame in number[whole].unique():
        chosen = (whole & (number == frame)).nonzero().squeeze(1)
        where = grid.index_select(0, chosen).transpose(1, 2)[None]
        image = images[frame : frame + 1].to(places.dtype)
        sampled = functional.grid_sample(image, where, mode="bicubic", align_corners=True)
        found.index_copy_(0, chosen, sampled[0, 0])
    return found


def _steps(window: int, step: int, like: Tensor) -> Tensor:
    """(m, 2) px of a window's grid from its middle, of the dtype and device of `like`."""
    reach = window // 2
    offsets = torch.arange(-reach, reach + 1, step, dtype=like.dtype, device=like.device)
    y, x = torch.meshgrid(offsets, offsets, indexing="ij")
    return torch.stack((x.flatten(), y.flatten()), -1)


def deformed_alike(
    first: Tensor, images: Tensor, number: Tensor, places: Tensor, warp: Tensor, window: int, step: int
) -> Tensor:
    """The deformation (N, 2, 2), near `warp`, by which windows come nearest to what they were, their middles held.

    Gauss-Newton for a T + b = I(place + F w) in gain, offset and the four numbers of F: what remains of a window whose
    middle is elsewhere is not explained by it. Arguments as for `sample_windows`, `first` (N, m) the windows then.
    """
    steps = _steps(window, step, places)
    for _ in range(_ROUNDS):
        here = sample_windows(images, number, places, warp, window, step)
        slopes = []
        for along in places.new_tensor([[_BESIDE, 0.0], [0.0, _BESIDE]]):
            sides = (sample_windows(images, number, places + one, warp, window, step) for one in (along, -along))
            slopes.append((next(sides) - next(sides)) / (2 * _BESIDE))
        by_warp = torch.cat([slope[..., None] * steps for slope in slopes], -1)
        unknown = torch.cat((by_warp, -first[..., None], -torch.ones_like(first)[..., None]), -1)
        known = unknown.isfinite().all(-1).all(-1) & here.isfinite().all(-1)
        if not known.any():
            break
        solved = torch.linalg.lstsq(unknown[known], -here[known][..., None]).solution[:, :4, 0]
        warp = warp.clone()
        warp[known] += solved.unflatten(1, (2, 2)).clamp(-_FARTHEST, _FARTHEST)
    return warp


def correlation(one: Tensor, other: Tensor) -> Tensor:
    """Normalised correlation (N,) of windows (N, m): whatever gain and offset of the light; NaN where one is blank."""
    first, second = (part - part.mean(1, keepdim=True) for part in (one, other))
    variances = first.square().mean(1) * second.square().mean(1)
    found = (first * second).mean(1) / variances.clamp_min(_LEAST_VARIANCE).sqrt()
    return torch.where(variances > _LEAST_VARIANCE, found, torch.nan)
