"""Kernels of tracking: templates prepared and found, windows searched, corners, noise."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from fingerflow.kernels.checks import (
    FRAME_KINDS,
    check_frames,
    check_indices,
    check_like,
    described,
    described_mask,
    empty,
    extent,
    mask_of,
    rows_in_one_piece,
)
from fingerflow.kernels.library import entry
from fingerflow.kernels.torch_op import torch_op
from fingerflow.ops.tracking_limits import NUMBERS, TABLE

__all__ = [
    "LARGEST_CORNER_WINDOW",
    "CornerPlaces",
    "FollowedPoints",
    "corners",
    "find_templates",
    "halve",
    "mean_response",
    "prepare_templates",
    "sample_windows",
    "search_windows",
    "spline_coefficients",
]

LARGEST_CORNER_WINDOW = 15
WIDEST_SEARCH = 1 << 15  # px, so that places in it are counted by 32 bits


@torch_op()
def prepare_templates(
    image: Tensor,
    points: Tensor,
    inverse_warp: Tensor | None,
    variance: Tensor,
    window: int,
    gain_offset: bool,
    rounding: float,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Start, samples, table and numbers of templates, as `ops.templates.Templates` has them.

    An image (B, 1, H, W) of FRAME_KINDS, H and W at least 4; float32 points (B, N, 2), inverse_warp (B, N, 2, 2) and
    variance (B,).

    Raises:
        TypeError, ValueError: another dtype, or shapes that do not belong together.
    """
    check_frames(image, tuple(FRAME_KINDS))
    batch, count = image.shape[0], points.shape[1]
    check_like("points", points, torch.float32, (batch, count, 2))
    check_like("variance", variance, torch.float32, (batch,))
    if inverse_warp is not None:
        check_like("inverse_warp", inverse_warp, torch.float32, (batch, count, 2, 2))
        inverse_warp = inverse_warp.contiguous()
    _check_window(window, image)
    image, variance = rows_in_one_piece(image), variance.contiguous()
    start = points.clone(memory_format=torch.contiguous_format)
    samples = empty(torch.float32, batch, count, 3, window * window)
    table, numbers = empty(torch.float32, batch, count, TABLE), empty(torch.float32, batch, count, NUMBERS)
    entry("prepare_templates")(
        **described(image),
        height=image.shape[2],
        width=image.shape[3],
        points=count,
        start=start,
        inverse_warp=inverse_warp,
        variance=variance,
        window=window,
        gain_offset=gain_offset,
        rounding=rounding,
        samples=samples,
        table=table,
        numbers=numbers,
        threads=torch.get_num_threads(),
    )
    return start, samples, table, numbers


class FollowedPoints(NamedTuple):
    """Of K frames, as `ops.templates.Found` has them, (K, B, N, ...); place and speed (B, N, 2) after the last one."""

    points: Tensor
    error: Tensor
    covariance: Tensor
    status: Tensor
    estimate: Tensor
    place: Tensor
    speed: Tensor


@torch_op()
def find_templates(
    templates: Sequence[Tensor],
    frames: Tensor,
    place: Tensor,
    speed: Tensor | None,
    variance: Tensor | None,
    rounds: int,
    rounding: float,
    forward_backward_limit: float,
    mismatch_limit: float,
) -> FollowedPoints:
    """Templates (start, samples, table, numbers) of B x N points followed through frames.

    Frames (K B, 1, H, W) of FRAME_KINDS, frame k of batch b at k B + b; place (B, N, 2) expected in the first frame
    less speed (B, N, 2) px a frame; variance (K B,) float32.

    Raises:
        TypeError, ValueError: another dtype, or shapes that do not belong together.
    """
    check_frames(frames, tuple(FRAME_KINDS))
    (batch, count), total = place.shape[:2], frames.shape[0]
    if total % max(batch, 1):
        raise ValueError(f"{total} frames cannot be those of {batch} recordings")
    steps, window = total // max(batch, 1) or 1, math.isqrt(templates[1].shape[-1])
    shapes = {"start": (2,), "samples": (3, window * window), "table": (TABLE,), "numbers": (NUMBERS,)}
    kept = {}
    for (name, last), tensor in zip(shapes.items(), templates, strict=True):
        check_like(name, tensor, torch.float32, (batch, count, *last))
        kept[name] = tensor.contiguous()
    check_like("place", place, torch.float32, (batch, count, 2))
    place = place.clone(memory_format=torch.contiguous_format)
    speed = torch.zeros_like(place) if speed is None else speed.clone(memory_format=torch.contiguous_format)
    check_like("speed", speed, torch.float32, (batch, count, 2))
    if variance is not None:
        check_like("variance", variance, torch.float32, (total,))
        variance = variance.contiguous()
    _check_window(window, frames)
    frames = rows_in_one_piece(frames)
    points, estimate, covariance = (empty(torch.float32, steps, batch, count, *last) for last in ((2,), (2,), (2, 2)))
    error, status = (empty(dtype, steps, batch, count) for dtype in (torch.float32, torch.uint8))
    entry("find_templates")(
        **described(frames),
        height=frames.shape[2],
        width=frames.shape[3],
        batch=batch,
        points=count,
        steps=steps,
        window=window,
        rounds=rounds,
        **kept,
        variance=variance,
        place=place,
        speed=speed,
        rounding=rounding,
        forward_backward_limit=forward_backward_limit,
        mismatch_limit=mismatch_limit,
        found=points,
        error=error,
        covariance=covariance,
        status=status,
        estimate=estimate,
        threads=torch.get_num_threads(),
    )
    return FollowedPoints(points, error, covariance, status, estimate, place, speed)


def _check_window(window: int, frames: Tensor) -> None:
    if window < 5 or window % 2 == 0:
        raise ValueError(f"window must be odd and at least 5 px, not {window}")
    if min(frames.shape[2:]) < 4:
        raise ValueError(f"frames of {tuple(frames.shape[2:])} px: 4 x 4 and more are needed")


@torch_op()
def halve(frames: Tensor) -> Tensor:
    """Means of 2 x 2 px (B, 1, H // 2, W // 2) float32, as `ops.search` has them, of frames of FRAME_KINDS.

    Raises:
        TypeError, ValueError: another dtype or shape, or frames below 3 x 3 px.
    """
    frames = _kernel_frames(frames)
    batch, _, height, width = frames.shape
    halved = empty(torch.float32, batch, 1, height // 2, width // 2)
    threads = torch.get_num_threads()
    entry("halve")(frames=frames, halved=halved, **extent(frames), kind=FRAME_KINDS[frames.dtype], threads=threads)
    return halved


@torch_op()
def mean_response(frames: Tensor) -> Tensor:
    """Mean absolute response (B,) float64 of the mask of `ops.noise`, of frames of FRAME_KINDS, at least 3 x 3.

    Raises:
        TypeError, ValueError: another dtype or shape, or smaller frames.
    """
    frames = _kernel_frames(frames)
    means = empty(torch.float64, frames.shape[0])
    threads = torch.get_num_threads()
    entry("mean_response")(
        frames=frames, means=means, **extent(frames), kind=FRAME_KINDS[frames.dtype], threads=threads
    )
    return means


@torch_op()
def spline_coefficients(frames: Tensor) -> Tensor:
    """(B, 1, H, W) float32, as `ops.spline` has them, bit for bit, of frames of FRAME_KINDS.

    Raises:
        TypeError, ValueError: another dtype or shape.
    """
    check_frames(frames, tuple(FRAME_KINDS))
    frames = rows_in_one_piece(frames)
    coefficients = empty(torch.float32, *frames.shape)
    entry("spline_coefficients")(
        frames=frames,
        coefficients=coefficients,
        **extent(frames),
        kind=FRAME_KINDS[frames.dtype],
        threads=torch.get_num_threads(),
    )
    return coefficients


def _kernel_frames(frames: Tensor) -> Tensor:
    check_frames(frames, tuple(FRAME_KINDS))
    if min(frames.shape[2:]) < 3:
        raise ValueError(f"frames of {tuple(frames.shape[2:])} px: this compiled kernel needs at least 3 x 3")
    return rows_in_one_piece(frames)


@torch_op()
def search_windows(
    templates: Tensor, images: Tensor, image_index: Tensor, points: Tensor, guess: Tensor, size: int, reach: int
) -> Tensor:
    """Places (P, 2) as `ops.search` has them, from images (B, 1, h, w) of half resolution, all float32.

    Image_index (P,) int64, points and guess (P, 2); templates `size` wide, found up to `reach` px away.

    Raises:
        TypeError, ValueError: another dtype, shapes that do not belong together, an even size or a negative reach.
    """
    count = points.shape[0]
    check_frames(templates, (torch.float32,))
    check_like("images", images, torch.float32, tuple(templates.shape))
    check_like("image_index", image_index, torch.int64, (count,))
    check_indices("image_index", image_index, images.shape[0], "images")
    check_like("points", points, torch.float32, (count, 2))
    check_like("guess", guess, torch.float32, (count, 2))
    if size < 1 or size % 2 == 0 or reach < 0 or (count and min(images.shape[2:]) < 1):
        raise ValueError(f"templates {size} wide, {reach} px away, in images of {tuple(images.shape)}")
    if size + 2 * reach > WIDEST_SEARCH:
        raise ValueError(f"templates {size} wide, {reach} px away: the compiled search ends at {WIDEST_SEARCH} px")
    found = empty(torch.float32, count, 2)
    entry("search_windows")(
        templates=templates.contiguous(),
        images=images.contiguous(),
        height=images.shape[2],
        width=images.shape[3],
        image_index=image_index.contiguous(),
        points=points.contiguous(),
        guess=guess.contiguous(),
        count=count,
        size=size,
        reach=reach,
        found=found,
        threads=torch.get_num_threads(),
    )
    return found


@torch_op()
def sample_windows(images: Tensor, image_index: Tensor, places: Tensor, warp: Tensor, window: int, step: int) -> Tensor:
    """Windows (N, m) as `ops.window_correlation` has them, to the rounding of their places, of images (n, 1, H, W) of
    FRAME_KINDS, at least 4 x 4.

    Image_index (N,) int64; places (N, 2) and warp (N, 2, 2) float32.

    Raises:
        TypeError, ValueError: another dtype, shapes that do not belong together, smaller images, a window or a step
            below 1.
    """
    check_frames(images, tuple(FRAME_KINDS))
    count, reach = places.shape[0], window // 2
    check_like("image_index", image_index, torch.int64, (count,))
    check_indices("image_index", image_index, images.shape[0], "images")
    check_like("places", places, torch.float32, (count, 2))
    check_like("warp", warp, torch.float32, (count, 2, 2))
    if window < 1 or step < 1 or min(images.shape[2:]) < 4:
        raise ValueError(f"windows of {window} px by steps of {step} in images of {tuple(images.shape[2:])}")
    images = rows_in_one_piece(images)
    found = empty(torch.float32, count, (2 * reach // step + 1) ** 2)
    entry("sample_windows")(
        **described(images),
        height=images.shape[2],
        width=images.shape[3],
        image_index=image_index.contiguous(),
        places=places.contiguous(),
        warp=warp.contiguous(),
        windows=count,
        reach=reach,
        step=step,
        found=found,
        threads=torch.get_num_threads(),
    )
    return found


class CornerPlaces(NamedTuple):
    """Points (B, count, 2) and response (B, count), float32, strongest first; NaN behind the last."""

    points: Tensor
    response: Tensor


@torch_op()
def corners(
    frames: Tensor,
    mask: Tensor | None,
    floors: Tensor,
    *,
    count: int,
    min_distance: float,
    quality: float,
    window: int,
    border: int,
) -> CornerPlaces:
    """Corners of uint8 frames (B, 1, H, W), as `ops.corners` has them; responses exceed `floors` (B,) float32.

    Raises:
        TypeError, ValueError: another dtype or shape, a window that is even or above 15, 2^32 pixels a frame or more.
    """
    check_frames(frames, (torch.uint8,))
    batch, _, height, width = frames.shape
    check_like("floors", floors, torch.float32, (batch,))
    if not 1 <= window <= LARGEST_CORNER_WINDOW or window % 2 == 0:
        raise ValueError(f"compiled corners have odd windows up to {LARGEST_CORNER_WINDOW}: {window} was asked for")
    if height * width >= 1 << 32:
        raise ValueError(f"a frame of {height} x {width}: compiled corners take fewer than 2^32 pixels")
    frames, floors = rows_in_one_piece(frames), floors.contiguous()
    mask = None if mask is None else mask_of(frames, mask)
    points, responses = empty(torch.float32, batch, count, 2), empty(torch.float32, batch, count)
    entry("corners")(
        frames=frames,
        **extent(frames),
        **described_mask(mask),
        floors=floors,
        quality=quality,
        window=window,
        border=border,
        count=count,
        min_distance=min_distance,
        points=points,
        responses=responses,
        threads=torch.get_num_threads(),
    )
    return CornerPlaces(points, responses)
