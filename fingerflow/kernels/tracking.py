"""Kernels of tracking: templates, registration and search of windows, spline and noise."""

import math
from collections.abc import Sequence
from typing import Generic, NamedTuple

from fingerflow.kernels.arrays import Array, copied, empty, in_one_piece, kind, rows_in_one_piece, zeros
from fingerflow.kernels.checks import (
    check_axes,
    check_frames,
    check_indices,
    check_like,
    checked,
    described,
)
from fingerflow.kernels.library import entry, threads
from fingerflow.kernels.tracking_limits import NUMBERS

WIDEST_SEARCH = 1 << 15  # px, widest search: positions in it must be countable with 32 bits
WIDEST_WINDOW = (1 << 12) - 1  # px, widest window: the pixels of a few windows must be countable with 32 bits


def prepare_templates(
    image: Array,
    points: Array,
    inverse_warp: Array | None,
    variance: Array,
    window: int,
    gain_offset: bool,
    rounding: float,
) -> tuple[Array, Array, Array]:
    """Prepare the templates by which points (B, N, 2) px of an image are tracked: return their reference positions, the
    samples of their windows (grey levels and gradients) and statistics.

    They are defined as in `ops.tracking.templates.Templates`. The image is (B, 1, H, W) of FRAME_KINDS, H and W at
    least 4. `points` (B, N, 2), `inverse_warp` (B, N, 2, 2) and `variance` (B,) are float32.

    Raises:
        TypeError, ValueError: wrong dtype, or inconsistent shapes.
    """
    check_frames(image)
    check_axes("points", points, 3)
    batch, count = image.shape[0], points.shape[1]
    check_like("points", points, "float32", (batch, count, 2))
    check_like("variance", variance, "float32", (batch,))
    if inverse_warp is not None:
        check_like("inverse_warp", inverse_warp, "float32", (batch, count, 2, 2))
        inverse_warp = in_one_piece(inverse_warp)
    _check_window(window, image)
    image, variance = rows_in_one_piece(image), in_one_piece(variance)
    start = copied(points)
    samples = empty(image, "float32", batch, count, 3, window * window)
    numbers = empty(image, "float32", batch, count, NUMBERS)
    entry("prepare_templates")(
        **described(image),
        points=count,
        start=start,
        inverse_warp=inverse_warp,
        variance=variance,
        window=window,
        gain_offset=gain_offset,
        rounding=rounding,
        samples=samples,
        numbers=numbers,
        threads=threads(),
    )
    return start, samples, numbers


class FollowedPoints(NamedTuple, Generic[Array]):
    """Tracking results (K, B, N, ...) of points in K frames, with the attributes of `ops.tracking.templates.Found`.

    `place` and `speed` (B, N, 2) are those after the last frame.
    """

    points: Array
    error: Array
    covariance: Array
    status: Array
    estimate: Array
    place: Array
    speed: Array


def find_templates(
    templates: Sequence[Array],
    frames: Array,
    place: Array,
    speed: Array | None,
    variance: Array | None,
    rounds: int,
    rounding: float,
    forward_backward_limit: float,
    mismatch_limit: float,
) -> FollowedPoints[Array]:
    """Track the templates of B x N points through K frames each, in one call.

    Frames are (K B, 1, H, W) of FRAME_KINDS, frame k of batch b at k B + b. The prediction for the first frame is
    `place` + `speed`, both (B, N, 2), px and px a frame. `variance` (K B,) is float32.

    Raises:
        TypeError, ValueError: wrong dtype, or inconsistent shapes.
    """
    check_frames(frames)
    check_axes("place", place, 3)
    (batch, count, _), total = place.shape, frames.shape[0]
    if total % max(batch, 1):
        raise ValueError(f"{total} frames cannot be those of {batch} recordings")
    if len(templates) != 3:
        raise ValueError(f"{len(templates)} arrays are no templates: give start, samples and numbers")
    check_axes("samples", templates[1], 4)
    steps, window = total // batch if batch else 1, math.isqrt(templates[1].shape[-1])
    shapes = {"start": (2,), "samples": (3, window * window), "numbers": (NUMBERS,)}
    kept = {}
    for (name, last), tensor in zip(shapes.items(), templates, strict=True):
        check_like(name, tensor, "float32", (batch, count, *last))
        kept[name] = in_one_piece(tensor)
    check_like("place", place, "float32", (batch, count, 2))
    place = copied(place)
    speed = zeros(place, "float32", *place.shape) if speed is None else copied(speed)
    check_like("speed", speed, "float32", (batch, count, 2))
    if variance is not None:
        check_like("variance", variance, "float32", (total,))
        variance = in_one_piece(variance)
    _check_window(window, frames)
    frames = rows_in_one_piece(frames)
    size = (steps, batch, count)
    points, estimate, covariance = (empty(frames, "float32", *size, *last) for last in ((2,), (2,), (2, 2)))
    error, status = (empty(frames, dtype, *size) for dtype in ("float32", "uint8"))
    entry("find_templates")(
        **described(frames),
        recordings=batch,
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
        threads=threads(),
    )
    return FollowedPoints(points, error, covariance, status, estimate, place, speed)


class FoundPairs(NamedTuple, Generic[Array]):
    """Positions, errors, covariances and statuses (B, N, ...) of points registered in image pairs, as
    `ops.tracking.templates.Found`, and the statistics `numbers` of their templates.

    `numbers` are the template statistics of `Templates`.
    """

    points: Array
    error: Array
    covariance: Array
    status: Array
    estimate: Array
    numbers: Array


def find_pairs(
    previous: Array,
    current: Array,
    points: Array,
    inverse_warp: Array | None,
    variance: Array,
    place: Array,
    window: int,
    gain_offset: bool,
    rounds: int,
    rounding: float,
    forward_backward_limit: float,
    mismatch_limit: float,
) -> FoundPairs[Array]:
    """Register points (B, N, 2) px of the images `previous` in the images `current`, near `place` (B, N, 2), by
    templates prepared and used in one call.

    This is `prepare_templates` and `find_templates` without writing samples to memory. Images are (B, 1, H, W) of one
    of FRAME_KINDS; `variance` (B,) is that of both.

    Raises:
        TypeError, ValueError: wrong dtype, or inconsistent shapes.
    """
    check_frames(previous)
    check_like("current", current, kind(previous), tuple(previous.shape))
    check_axes("points", points, 3)
    batch, count = previous.shape[0], points.shape[1]
    check_like("points", points, "float32", (batch, count, 2))
    check_like("place", place, "float32", (batch, count, 2))
    check_like("variance", variance, "float32", (batch,))
    if inverse_warp is not None:
        check_like("inverse_warp", inverse_warp, "float32", (batch, count, 2, 2))
        inverse_warp = in_one_piece(inverse_warp)
    _check_window(window, previous)
    previous, current = in_one_piece(previous), in_one_piece(current)
    size = (batch, count)
    found, estimate, covariance = (empty(previous, "float32", *size, *last) for last in ((2,), (2,), (2, 2)))
    error, numbers = empty(previous, "float32", *size), empty(previous, "float32", *size, NUMBERS)
    status = empty(previous, "uint8", *size)
    entry("find_pairs")(
        **described(previous),
        current=current,
        points=count,
        start=copied(points),
        inverse_warp=inverse_warp,
        variance=in_one_piece(variance),
        window=window,
        gain_offset=gain_offset,
        rounds=rounds,
        place=copied(place),
        speed=zeros(place, "float32", *place.shape),
        rounding=rounding,
        forward_backward_limit=forward_backward_limit,
        mismatch_limit=mismatch_limit,
        numbers=numbers,
        found=found,
        error=error,
        covariance=covariance,
        status=status,
        estimate=estimate,
        threads=threads(),
    )
    return FoundPairs(found, error, covariance, status, estimate, numbers)


def _check_window(window: int, frames: Array) -> None:
    if not 5 <= window <= WIDEST_WINDOW or window % 2 == 0:
        raise ValueError(f"window must be odd, at least 5 px and at most {WIDEST_WINDOW} px, not {window}")
    if min(frames.shape[2:]) < 4:
        raise ValueError(f"frames of {tuple(frames.shape[2:])} px: 4 x 4 and more are needed")


def halve(frames: Array) -> Array:
    """Halve the resolution of frames by averaging 2 x 2 px, to (B, 1, H // 2, W // 2) float32.

    The results equal those of `ops.filters.halving`.

    Raises:
        TypeError, ValueError: wrong dtype or shape, or frames below 3 x 3 px.
    """
    frames = _kernel_frames(frames)
    batch, _, height, width = frames.shape
    halved = empty(frames, "float32", batch, 1, height // 2, width // 2)
    entry("halve")(**described(frames), halved=halved, threads=threads())
    return halved


def mean_response(frames: Array) -> Array:
    """Return the mean absolute value (B,) float64 of frames (B, 1, H, W) convolved with the mask [1 -2 1]^T [1 -2 1] of
    `ops.filters.noise`.

    The noise estimate is proportional to it. Frames are of FRAME_KINDS, at least 3 x 3 px.

    Raises:
        TypeError, ValueError: wrong dtype or shape, or smaller frames.
    """
    frames = _kernel_frames(frames)
    means = empty(frames, "float64", frames.shape[0])
    entry("mean_response")(**described(frames), means=means, threads=threads())
    return means


def spline_coefficients(frames: Array) -> Array:
    """Compute the spline coefficients (B, 1, H, W) float32 of frames, bit for bit as `ops.filters.spline`.

    Frames are of FRAME_KINDS.

    Raises:
        TypeError, ValueError: wrong dtype or shape.
    """
    check_frames(frames)
    frames = rows_in_one_piece(frames)
    coefficients = empty(frames, "float32", *frames.shape)
    entry("spline_coefficients")(**described(frames), coefficients=coefficients, threads=threads())
    return coefficients


def _kernel_frames(frames: Array) -> Array:
    check_frames(frames)
    if min(frames.shape[2:]) < 3:
        raise ValueError(f"frames of {tuple(frames.shape[2:])} px: this compiled kernel needs at least 3 x 3")
    return rows_in_one_piece(frames)


def search_windows(
    templates: Array, images: Array, image_index: Array, points: Array, guess: Array, size: int, reach: int
) -> Array:
    """Search in `images` for the windows around `points` of the images `templates`, both (B, 1, h, w) of half
    resolution, near `guess`; return the positions (P, 2) of highest correlation, as `ops.tracking.search`.

    All are float32 but `image_index` (P,) int64. `points` and `guess` are (P, 2). Templates are `size` px wide and
    searched for up to `reach` px away.

    Raises:
        TypeError, ValueError: wrong dtype, inconsistent shapes, an even size, a negative reach, or a search wider than
            WIDEST_SEARCH.
    """
    check_frames(templates, ("float32",))
    check_axes("points", points, 2)
    count = points.shape[0]
    check_like("images", images, "float32", tuple(templates.shape))
    check_like("image_index", image_index, "int64", (count,))
    check_indices("image_index", image_index, images.shape[0], "images")
    if size < 1 or size % 2 == 0 or reach < 0 or (count and min(images.shape[2:]) < 1):
        raise ValueError(f"templates {size} wide, {reach} px away, in images of {tuple(images.shape)}")
    if size + 2 * reach > WIDEST_SEARCH:
        raise ValueError(f"templates {size} wide, {reach} px away: the compiled search ends at {WIDEST_SEARCH} px")
    found = empty(templates, "float32", count, 2)
    entry("search_windows")(
        templates=in_one_piece(templates),
        images=in_one_piece(images),
        height=images.shape[2],
        width=images.shape[3],
        image_index=in_one_piece(image_index),
        points=checked("points", points, "float32", (count, 2)),
        guess=checked("guess", guess, "float32", (count, 2)),
        count=count,
        size=size,
        reach=reach,
        found=found,
        threads=threads(),
    )
    return found


def sample_windows(images: Array, image_index: Array, places: Array, warp: Array, window: int, step: int) -> Array:
    """Sample the grey levels (N, m) of images in windows around `places`, each deformed by its matrix in `warp`, as
    `ops.tracking.window_correlation` up to rounding of positions.

    Images are (n, 1, H, W) of FRAME_KINDS, at least 4 x 4 px; `image_index` (N,) is int64, `places` (N, 2) and `warp`
    (N, 2, 2) are float32.

    Raises:
        TypeError, ValueError: wrong dtype, inconsistent shapes, smaller images, a window or a step below 1, a window
            above WIDEST_WINDOW.
    """
    check_frames(images)
    check_axes("places", places, 2)
    count, reach = places.shape[0], window // 2
    check_like("image_index", image_index, "int64", (count,))
    check_indices("image_index", image_index, images.shape[0], "images")
    if not 1 <= window <= WIDEST_WINDOW or step < 1 or min(images.shape[2:]) < 4:
        raise ValueError(f"windows of {window} px by steps of {step} in images of {tuple(images.shape[2:])}")
    images = rows_in_one_piece(images)
    found = empty(images, "float32", count, (2 * reach // step + 1) ** 2)
    entry("sample_windows")(
        **described(images),
        image_index=in_one_piece(image_index),
        places=checked("places", places, "float32", (count, 2)),
        warp=checked("warp", warp, "float32", (count, 2, 2)),
        windows=count,
        reach=reach,
        step=step,
        found=found,
        threads=threads(),
    )
    return found
