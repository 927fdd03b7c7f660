"""Skin points worth tracking: corners with gradients in two directions (Shi & Tomasi 1994), well apart."""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.tensors.torch_op import torch_op
from fingerflow.ops.contact.cells import widest
from fingerflow.ops.filters.box_sum import box_sum
from fingerflow.ops.filters.noise import estimate_noise

_GRADIENT_SCALE = 8  # of Sobel's gradient in whole numbers
# White noise of variance 1 leaves this variance in a component of the gradient: the sum of its squared weights,
# (1 + 4 + 1) 2.
_GRADIENT_NOISE = 12 / _GRADIENT_SCALE**2
# Below this share of the larger eigenvalue the smaller one is what float32 leaves of a difference of equal numbers.
_ROUNDING = 1e-5


class Corners(NamedTuple):
    """Strongest first: `points` (B, count, 2) as (x, y) px, `response` (B, count), `valid` (B, count) bool.

    Where fewer corners than `count` exist, the rest is NaN and not valid.
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
    """The `count` strongest corners at least `min_distance` apart, on whole pixels.

    Candidates are the local maxima of `corner_response` (3 x 3). Taken strongest first, each is kept unless it lies
    nearer than `min_distance` to one that is kept already; of equally strong ones the first in reading order goes
    first. Tracking finds sub-pixel displacements from whole-pixel starts, so the positions are not refined.

    A response must pass three thresholds. `quality` is relative to the strongest response of the frame (inside mask
    and border), and by itself it finds corners in the noise of a blank frame. So the response must also exceed what no
    window of pure white noise reaches; and 1e-5 of the other eigenvalue, because a pattern of one direction (the
    aperture problem) leaves a rounding error there.

    Args:
        frame: (B, 1, H, W), integers or floating, H and W at least 3.
        count: number of corners a frame.
        min_distance: px, Euclidean; exactly this distance is allowed.
        mask: (B or 1, 1, H, W) bool, where corners may lie; None for everywhere.
        quality: least share of the strongest response.
        window: side of the window of the structure tensor, px, odd.
        border: px at each side of the frame without corners: half a tracking window keeps that window inside.
        noise: standard deviation of the camera noise in the units of `frame`; None to estimate it a frame
            (`estimate_noise`), to which integers add the variance of rounding, 1/12. The estimate takes texture
            finer than about 4 px for noise: give the camera's noise where such texture is to be tracked.

    Returns:
        `Corners`, float32 (float64 for float64 frames). uint8 frames are worked on in whole numbers up to the
        eigenvalues. Non-finite pixels spoil the windows that hold them, and nothing else.

    Raises:
        ValueError: a shape or a number out of its range, with its value.
    """
    if count < 0 or border < 0 or not min_distance >= 0 or not 0 <= quality <= 1:
        raise ValueError(
            f"count {count}, border {border}, min_distance {min_distance} and quality {quality}: "
            "none may be negative, and quality is at most 1"
        )
    _check_frame(frame, window)
    exact = frame.dtype == torch.uint8 and window <= kernels.LARGEST_CORNER_WINDOW
    if exact and frame.numel() and kernels.serve(frame, mask):
        spread = (
            _noise_deviation(frame)
            if noise is None
            else torch.full((len(frame),), noise, dtype=torch.float32, device=frame.device)
        )
        points, strength = kernels.corners(
            frame,
            mask,
            _above_noise(window) * spread.square(),
            count=count,
            min_distance=min_distance,
            quality=quality,
            window=window,
            border=border,
        )
        return Corners(points, strength, strength.isfinite())
    response, larger = _eigenvalues(frame, window)
    allowed = _inside(frame, border)
    if mask is not None:
        allowed = allowed & mask
    spread = _noise_deviation(frame) if noise is None else torch.full_like(response[:, 0, 0, 0], noise)
    known = torch.where(allowed & response.isfinite(), response, 0.0)
    floor = torch.maximum(quality * known.amax((1, 2, 3)), _above_noise(window) * spread.square())
    peak = known == widest(known)
    candidate = peak & (known > floor[:, None, None, None]) & (known > _ROUNDING * larger)
    return _strongest_apart(known, candidate, count, min_distance)


def corner_response(frame: Tensor, window: int = 7) -> Tensor:
    """The smaller eigenvalue of the structure tensor: the mean squared gradient along the direction that has least.

    Args:
        frame: (B, 1, H, W), integers or floating.
        window: side of the box over which the tensor is averaged, px, odd.

    Returns:
        (B, 1, H, W) in (grey level / px)^2, float32 (float64 for float64 frames); NaN where the window and the
        gradient's pixel around it hold a non-finite pixel. Outside the frame the nearest pixel counts. Gradients flow,
        except where both eigenvalues are equal.

    Raises:
        ValueError: `frame` is not (B, 1, H, W) or `window` is not odd and positive.
    """
    _check_frame(frame, window)
    return _eigenvalues(frame, window)[0]


def _check_frame(frame: Tensor, window: int) -> None:
    if frame.ndim != 4 or frame.shape[1] != 1:
        raise ValueError(f"frame has shape {tuple(frame.shape)}: give (B, 1, H, W)")
    if window < 1 or window % 2 == 0:
        raise ValueError(f"window is {window} px: the structure tensor needs an odd one")


def _eigenvalues(frame: Tensor, window: int) -> tuple[Tensor, Tensor]:
    """Smaller and larger eigenvalue of the structure tensor, (B, 1, H, W) each."""
    whole = frame.dtype == torch.uint8
    values = frame.double() if whole or frame.dtype == torch.float64 else frame.float()
    values = torch.where(values.isfinite(), values, torch.nan)
    gradient_x, gradient_y = _gradient(values)
    tensor = torch.cat([gradient_x * gradient_x, gradient_x * gradient_y, gradient_y * gradient_y], 1)
    half = window // 2
    if tensor.numel():
        padded = functional.pad(tensor, (half, half, half, half), mode="replicate")
        tensor = box_sum(padded, window)
    xx, xy, yy = tensor.split(1, 1)
    both, apart, twice = xx + yy, xx - yy, 2 * xy
    if whole:
        # Whole numbers up to here; from here on single roundings in a fixed order, as the compiled twin takes them.
        both, apart, twice = both.float(), apart.float(), twice.float()
        # By way of float64: torch's float32 root is not the nearest number for all.
        spread = (apart.square() + twice.square()).double().sqrt().float()
    else:
        spread = torch.hypot(apart, twice)
    scale = 1 / (2 * _GRADIENT_SCALE**2 * window * window)
    return (both - spread) * scale, (both + spread) * scale


def _gradient(values: Tensor) -> tuple[Tensor, Tensor]:
    """Sobel's derivative in eighths of a grey level a pixel: [-1 0 1] one way, [1 2 1] the other."""
    if values.numel() == 0:
        return values, values
    padded = functional.pad(values, (1, 1, 1, 1), mode="replicate")
    smooth_y = padded[..., :-2, :] + 2 * padded[..., 1:-1, :] + padded[..., 2:, :]
    smooth_x = padded[..., :-2] + 2 * padded[..., 1:-1] + padded[..., 2:]
    return smooth_y[..., 2:] - smooth_y[..., :-2], smooth_x[..., 2:, :] - smooth_x[..., :-2, :]


def _above_noise(window: int) -> float:
    """The response, for white noise of variance 1, that no window of pure noise reaches.

    The mean response of pure noise is its gradient variance; small windows scatter more around it. The largest of two
    million windows, the frame's corners included, where few pixels count several times, was measured at 6.2, 4.4, 2.7
    and 2.1 times the gradient variance for windows of 3, 5, 9 and 15 px; the line below stands at 7, 4.6, 3 and 2.2.
    """
    return _GRADIENT_NOISE * (1 + 18 / window)


def _noise_deviation(frame: Tensor) -> Tensor:
    """(B,) grey levels; non-finite pixels are taken at the mean of the others, which hardly raises the estimate."""
    if min(frame.shape[-2:]) < 3:
        raise ValueError(f"frame of {tuple(frame.shape[-2:])} px: noise needs at least 3 x 3 px; give noise=")
    if frame.is_floating_point():
        values, finite = frame.float() if frame.itemsize < 4 else frame, frame.isfinite()
        zeroed = torch.where(finite, values, 0.0)
        mean = zeroed.sum((1, 2, 3), keepdim=True) / finite.sum((1, 2, 3), keepdim=True).clamp(min=1)
        return estimate_noise(torch.where(finite, values, mean))
    # Of noise under a grey level rounding leaves few, isolated ones, which a mean absolute value underrates.
    return (estimate_noise(frame).square() + 1 / 12).sqrt()


def _inside(frame: Tensor, border: int) -> Tensor:
    """(1, 1, H, W) bool: pixels at least `border` away from the edge of the frame."""
    height, width = frame.shape[-2:]
    y, x = torch.arange(height, device=frame.device), torch.arange(width, device=frame.device)
    rows, columns = (y >= border) & (y < height - border), (x >= border) & (x < width - border)
    return (rows[:, None] & columns)[None, None]


def _strongest_apart(response: Tensor, candidate: Tensor, count: int, min_distance: float) -> Corners:
    place = choose_apart(response.detach(), candidate, count, min_distance)
    found, index = place >= 0, place.clamp_min(0)
    width = response.shape[3]
    points = torch.stack((index % width, index // width), dim=2).to(response.dtype)
    strengths = response.flatten(1).gather(1, index)
    points = torch.where(found[..., None], points, torch.nan)
    strengths = torch.where(found, strengths, torch.nan)
    return Corners(points, strengths, strengths.isfinite())


def _as_many(response: Tensor, candidate: Tensor, count: int, min_distance: float) -> Tensor:
    return candidate.new_empty((candidate.shape[0], count), dtype=torch.int64)


@torch_op(shapes=_as_many)
def choose_apart(response: Tensor, candidate: Tensor, count: int, min_distance: float) -> Tensor:
    """Pixels (B, count) int64 of frames, row after row, strongest first, none nearer to a stronger one than
    `min_distance`; -1 behind the last.
    """
    batch, _, height, width = response.shape
    frame, y, x = candidate[:, 0].nonzero().unbind(1)
    strength = response[:, 0][candidate[:, 0]]
    # Frame by frame, strongest first; both sorts keep reading order among equals.
    order = strength.sort(descending=True, stable=True).indices
    order = order[frame[order].sort(stable=True).indices]
    frame, y, x = frame[order], y[order], x[order]
    kept = _keep_apart(frame, y, x, (batch, height, width), min_distance)
    frame, y, x = frame[kept], y[kept], x[kept]

    found = torch.bincount(frame, minlength=batch)
    place = torch.arange(len(frame), device=frame.device) - (found.cumsum(0) - found)[frame]
    some = place < count
    chosen = frame.new_full((batch, count), -1)
    chosen[frame[some], place[some]] = (y * width + x)[some]
    return chosen


def _keep_apart(frame: Tensor, y: Tensor, x: Tensor, shape: tuple[int, int, int], distance: float) -> Tensor:
    """Which candidates, given strongest first, the greedy rule keeps: the same answer for many at a time.

    The frame is divided into cells so small that two candidates of one cell are always too near. A candidate that
    is the first of all undecided ones in the cells around it will be kept whatever happens elsewhere; it then removes
    those near it, and so on until all are decided.
    """
    if distance <= 1:  # different pixels are never nearer
        return torch.ones_like(x, dtype=torch.bool)
    side = max(1, math.ceil(distance / math.sqrt(2)))  # (side - 1) sqrt(2) < distance
    around = math.ceil(distance / side)
    rows, columns = -(-shape[1] // side) + 2 * around, -(-shape[2] // side) + 2 * around
    cell = (frame * rows + y // side + around) * columns + x // side + around
    offset = torch.arange(-around, around + 1, device=x.device)
    around_cell = (offset[:, None] * columns + offset).flatten()

    none = len(x)  # an index beyond all candidates
    nobody = cell.new_full((shape[0] * rows * columns,), none)
    far = x.new_full((1,), 1 << 30)  # where nobody is
    x, y = torch.cat([x, far]), torch.cat([y, far])
    kept = torch.zeros_like(x[:-1], dtype=torch.bool)
    index = torch.arange(none, device=x.device)  # of the undecided
    while len(index):
        neighbours = cell[index, None] + around_cell
        first = nobody.scatter_reduce(0, cell[index], index, "amin")
        chosen = index[first[neighbours].amin(1) == index]
        kept[chosen] = True
        near = nobody.scatter(0, cell[chosen], chosen)[neighbours]
        squared = (x[near] - x[index, None]).square() + (y[near] - y[index, None]).square()
        index = index[~(squared < distance * distance).any(1)]
    return kept
