"""Corners for tracking: pixels with gradients in two directions (Shi & Tomasi 1994), a minimum distance apart."""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from fingerflow.kernels.tensors.torch_op import torch_op
from fingerflow.ops.branching import may_branch
from fingerflow.ops.checks import check_frames
from fingerflow.ops.contact.cells import largest_around
from fingerflow.ops.filters.box_sum import box_sum
from fingerflow.ops.filters.noise import estimate_noise, rounding_variance
from fingerflow.ops.tensors import hypotenuse

_GRADIENT_SCALE = 8  # ratio of the integer Sobel gradient to the gradient per pixel
# Variance of a gradient component for white noise of variance 1: the sum of the squared weights is (1 + 4 + 1) 2.
_GRADIENT_NOISE = 12 / _GRADIENT_SCALE**2
# Share of the larger eigenvalue below which the smaller one is a float32 rounding error of a difference.
_ROUNDING = 1e-5
_STRIP = 1 << 15  # pixels of a strip of rows that is computed at once


class Corners(NamedTuple):
    """Corners detected in B frames, strongest first; entries beyond the corners found are NaN and not valid.

    Attributes:
        points: (B, count, 2) as (x, y) px.
        response: (B, count), see `corner_response`.
        valid: (B, count) bool.
    """

    points: Tensor
    response: Tensor
    valid: Tensor


def detect_corners(
    frame: Tensor,
    count: int = 700,
    min_distance: float = 7.0,
    mask: Tensor | None = None,
    *,
    quality: float = 0.01,
    window: int = 7,
    border: int = 0,
    noise: float | None = None,
) -> Corners:
    """Return the `count` strongest corners that are at least `min_distance` apart, on whole pixels.

    Candidates are the local maxima (3 x 3) of `corner_response`. They are visited in order of strength; equally strong
    ones in reading order. A candidate is kept unless it lies nearer than `min_distance` to one that is already kept.
    The positions are not refined: tracking finds sub-pixel displacements from whole-pixel reference positions.

    A response must exceed three thresholds:
    - `quality` times the strongest response of the frame inside mask and border. Alone, it would accept corners in the
      noise of a blank frame.
    - The response that no window of pure white noise reaches.
    - 1e-5 of the larger eigenvalue. A pattern of one direction (the aperture problem) leaves a rounding error of that
      size.

    Args:
        frame: (B, 1, H, W), integers or floating, H and W at least 3.
        count: number of corners per frame.
        min_distance: px, Euclidean; exactly this distance is allowed.
        mask: (B or 1, 1, H, W) bool, where corners may lie; None for everywhere.
        quality: smallest share of the strongest response.
        window: side of the window of the structure tensor, px, odd.
        border: px at each side of the frame without corners: half a tracking window keeps that window inside.
        noise: standard deviation of the camera noise in the units of `frame`. None estimates it per frame
            (`estimate_noise`) and adds the rounding variance 1/12 for integer frames. The estimate mistakes texture
            finer than about 4 px for noise: pass the camera's noise where such texture is to be tracked.

    Returns:
        `Corners`, float32 (float64 for float64 frames). For uint8 frames the arithmetic is exact up to the eigenvalues.
        A non-finite pixel invalidates only the windows that contain it.

    Raises:
        ValueError: a shape or a number is out of range; the message gives its value.

    Source: Shi & Tomasi, CVPR 1994. No compiled twin.

    Convention:
        axes: points are (x, y) px, x to the right, y down.
        sign: the response is positive at a corner, bright or dark.
        pixel centre: whole numbers; (0, 0) is the upper left pixel.
        dtype: float32, or float64 if the frames are.
        NaN: in a pixel, leaves no corner where its window holds it; missing corners are NaN and not valid.
        border: the nearest pixel is repeated for gradients; no corner within `border` px.
    """
    if count < 0 or border < 0 or not min_distance >= 0 or not 0 <= quality <= 1:
        raise ValueError(
            f"count {count}, border {border}, min_distance {min_distance} and quality {quality}: "
            "none may be negative, and quality is at most 1"
        )
    _check_frame(frame, window)
    response, larger = _eigenvalues(frame, window)
    y, x = (torch.arange(size, device=frame.device) for size in frame.shape[-2:])
    rows, columns = ((pixels >= border) & (pixels < len(pixels) - border) for pixels in (y, x))
    allowed = rows[:, None] & columns  # at least `border` px inside the frame
    if mask is not None:
        allowed = allowed & mask
    spread = _noise_deviation(frame) if noise is None else torch.full_like(response[:, 0, 0, 0], noise)
    strength = torch.where(allowed & response.isfinite(), response, 0.0)
    # An upper limit of the response over `window` px in images of nothing but white noise of variance 1. In large
    # windows the response tends to the gradient variance; in small ones it scatters more. The maximum over two million
    # windows was 6.2, 4.4, 2.7 and 2.1 times that variance for windows of 3, 5, 9 and 15 px, the frame's corners
    # included, where a few pixels count several times. The formula gives 7, 4.6, 3 and 2.2.
    above_noise = _GRADIENT_NOISE * (1 + 18 / window)
    floor = torch.maximum(quality * strength.amax((1, 2, 3)), above_noise * spread.square())
    peak = strength == largest_around(strength)
    candidate = peak & (strength > floor[:, None, None, None]) & (strength > _ROUNDING * larger)
    index_of = choose_apart(strength.detach(), candidate, count, min_distance)
    valid, index = index_of >= 0, index_of.clamp_min(0)
    points = torch.stack((index % frame.shape[3], index // frame.shape[3]), dim=2).to(strength.dtype)
    strengths = torch.where(valid, strength.flatten(1).gather(1, index), torch.nan)
    return Corners(torch.where(valid[..., None], points, torch.nan), strengths, strengths.isfinite())


def corner_response(frame: Tensor, window: int = 7) -> Tensor:
    """Return the corner response of each pixel: the smaller eigenvalue of the structure tensor.

    It is the least mean squared gradient along any direction.

    Args:
        frame: (B, 1, H, W), integers or floating.
        window: side of the box over which the tensor is averaged, px, odd.

    Returns:
        (B, 1, H, W) in (grey level / px)^2, float32 (float64 for float64 frames). NaN where the window, or the pixel
        around it that the gradient needs, contains a non-finite pixel. The border is replicated. Differentiable, except
        where both eigenvalues are equal.

    Raises:
        ValueError: `frame` is not (B, 1, H, W) or `window` is not odd and positive.
    """
    _check_frame(frame, window)
    return _eigenvalues(frame, window)[0]


def _check_frame(frame: Tensor, window: int) -> None:
    check_frames(frame)
    if window < 1 or window % 2 == 0:
        raise ValueError(f"window is {window} px: the structure tensor needs an odd one")


def _eigenvalues(frame: Tensor, window: int) -> tuple[Tensor, Tensor]:
    """Return the smaller and the larger eigenvalue of the structure tensor, (B, 1, H, W) each.

    A CPU computes strips of rows, whose intermediate images stay in its cache: a third of the time.
    """
    height, reach = frame.shape[2], window // 2 + 1
    rows = max(window, _STRIP // max(1, frame.shape[3]))
    if not may_branch(frame) or height <= rows:
        return _eigenvalues_of(frame, window)
    strips = []
    for top in range(0, height, rows):
        first = max(0, top - reach)
        strip = _eigenvalues_of(frame[..., first : top + rows + reach, :], window)
        strips.append([part[..., top - first : top - first + rows, :] for part in strip])
    smaller, larger = (torch.cat(parts, 2) for parts in zip(*strips, strict=True))
    return smaller, larger


def _eigenvalues_of(frame: Tensor, window: int) -> tuple[Tensor, Tensor]:
    whole = frame.dtype == torch.uint8
    values = frame if frame.dtype == torch.float64 else frame.float()
    values = values if whole else torch.where(values.isfinite(), values, torch.nan)
    gradient_x, gradient_y = _gradient(values)
    tensor = torch.cat([gradient_x * gradient_x, gradient_x * gradient_y, gradient_y * gradient_y], 1)
    half = window // 2
    if tensor.numel():
        padded = functional.pad(tensor, (half, half, half, half), mode="replicate")
        # Products of 8-bit gradients are whole numbers below 2^24, and sums of up to 32 x 32 of xx + yy below 2^31.
        tensor = box_sum(padded.to(torch.int32 if window < 33 else torch.float64) if whole else padded, window)
    xx, xy, yy = tensor.split(1, 1)
    both, difference, twice = xx + yy, xx - yy, 2 * xy
    if whole:
        # Up to here integers are exact. From here on every operation rounds once.
        both, difference, twice = both.float(), difference.float(), twice.float()
        # Compute the root in float64, since torch's float32 square root is not correctly rounded for all values.
        spread = (difference.square() + twice.square()).double().sqrt().float()
    else:
        spread = hypotenuse(difference, twice)
    scale = 1 / (2 * _GRADIENT_SCALE**2 * window * window)
    return (both - spread) * scale, (both + spread) * scale


def _gradient(values: Tensor) -> tuple[Tensor, Tensor]:
    """Return Sobel's derivatives of images in x and y, in eighths of a grey level per pixel."""
    if values.numel() == 0:
        return values, values
    padded = functional.pad(values, (1, 1, 1, 1), mode="replicate")
    smooth_y = padded[..., :-2, :] + 2 * padded[..., 1:-1, :] + padded[..., 2:, :]
    smooth_x = padded[..., :-2] + 2 * padded[..., 1:-1] + padded[..., 2:]
    return smooth_y[..., 2:] - smooth_y[..., :-2], smooth_x[..., 2:, :] - smooth_x[..., :-2, :]


def _noise_deviation(frame: Tensor) -> Tensor:
    """Estimate the standard deviation (B,) of the noise in frames, in grey levels.

    Non-finite pixels are replaced by the mean of the others, which hardly raises the estimate.
    """
    if min(frame.shape[-2:]) < 3:
        raise ValueError(f"frame of {tuple(frame.shape[-2:])} px: noise needs at least 3 x 3 px; give noise=")
    if frame.is_floating_point():
        values, finite = frame.float() if frame.itemsize < 4 else frame, frame.isfinite()
        zeroed = torch.where(finite, values, 0.0)
        mean = zeroed.sum((1, 2, 3), keepdim=True) / finite.sum((1, 2, 3), keepdim=True).clamp(min=1)
        return estimate_noise(torch.where(finite, values, mean))
    # Rounding turns noise below one grey level into a few isolated steps, which a mean absolute value underestimates.
    return (estimate_noise(frame).square() + rounding_variance(frame)).sqrt()


@torch_op(shapes=lambda _, candidate, count, __: candidate.new_empty(candidate.shape[0], count, dtype=torch.int64))
def choose_apart(response: Tensor, candidate: Tensor, count: int, min_distance: float) -> Tensor:
    """Return flat pixel indices (B, count) int64 of the strongest candidates that are at least `min_distance` apart.

    They are sorted by strength; -1 fills the places behind the last.
    """
    batch, _, height, width = response.shape
    frame, y, x = candidate[:, 0].nonzero().unbind(1)
    strength = response[:, 0][candidate[:, 0]]
    # Sort by frame, then by strength; both sorts are stable and keep the reading order of equal strengths.
    order = strength.sort(descending=True, stable=True).indices
    order = order[frame[order].sort(stable=True).indices]
    frame, y, x = frame[order], y[order], x[order]
    (place, total), considered = _ranks(frame, batch), 2 * count
    while True:  # weaker candidates decide nothing about stronger ones
        strongest = (place < considered).nonzero()[:, 0]
        among = frame[strongest], y[strongest], x[strongest]
        kept = strongest[_keep_apart(*among, (batch, height, width), min_distance)]
        rank, number = _ranks(frame[kept], batch)
        if ((number >= count) | (total <= considered)).all():
            break
        considered *= 2
    kept, rank = kept[rank < count], rank[rank < count]
    chosen = frame.new_full((batch, count), -1)
    chosen[frame[kept], rank] = (y * width + x)[kept]
    return chosen


def _ranks(frame: Tensor, batch: int) -> tuple[Tensor, Tensor]:
    """Number the corner candidates of each frame from 0; return these numbers (K,), and the counts of candidates (B,).

    `frame` (K,) holds the index of each candidate's frame, in ascending order.
    """
    counts = torch.bincount(frame, minlength=batch)
    return torch.arange(len(frame), device=frame.device) - (counts.cumsum(0) - counts)[frame], counts


def _keep_apart(frame: Tensor, y: Tensor, x: Tensor, shape: tuple[int, int, int], distance: float) -> Tensor:
    """Return a mask of the corner candidates (`frame`, `y`, `x`) to keep: those at least `distance` px from every
    stronger candidate of the frame that is kept.

    Candidates are sorted by strength. The selection runs in parallel, with the result of the sequential one. The frame
    is divided into cells so small that two candidates of one cell are always too near. A candidate that comes first
    among all undecided ones of the surrounding cells is certain to be kept. It then removes the candidates near it.
    Both steps repeat until all candidates are decided.
    """
    if distance <= 1:  # distinct pixels are never nearer than 1 px
        return torch.ones_like(x, dtype=torch.bool)
    side = max(1, math.ceil(distance / math.sqrt(2)))  # (side - 1) sqrt(2) < distance
    around = math.ceil(distance / side)
    rows, columns = -(-shape[1] // side) + 2 * around, -(-shape[2] // side) + 2 * around
    cell = (frame * rows + y // side + around) * columns + x // side + around
    offset = torch.arange(-around, around + 1, device=x.device)
    around_cell = (offset[:, None] * columns + offset).flatten()

    none = len(x)  # index that means no candidate
    nobody = cell.new_full((shape[0] * rows * columns,), none)
    far = x.new_full((1,), 1 << 30)  # position of the missing candidate, far from all others
    x, y = torch.cat([x, far]), torch.cat([y, far])
    accepted = torch.zeros_like(x[:-1], dtype=torch.bool)
    index = torch.arange(none, device=x.device)  # indices of undecided candidates
    while len(index):
        neighbours = cell[index, None] + around_cell
        first = nobody.scatter_reduce(0, cell[index], index, "amin")
        chosen = index[first[neighbours].amin(1) == index]
        accepted[chosen] = True
        near = nobody.scatter(0, cell[chosen], chosen)[neighbours]
        squared = (x[near] - x[index, None]).square() + (y[near] - y[index, None]).square()
        index = index[~(squared < distance * distance).any(1)]
    return accepted
