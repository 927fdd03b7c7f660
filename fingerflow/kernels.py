"""The compiled twins of some ops: whether they serve, and one typed function for each.

They serve plain tensors on the processor, outside tracing, export, compilation and autograd, and give what the
portable op gives, bit for bit, or to rounding where a docstring says so. `FINGERFLOW_KERNELS=0` in the environment
turns them off. Where they were not built, because no C++ compiler was there at install time, the portable ops serve and
a log message of level INFO says so once.
"""

import ctypes
import functools
import importlib.util
import logging
import os
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from fingerflow.ops.median_rows import COMPILED_SIZES, median_table
from fingerflow.ops.tracking_limits import NUMBERS, TABLE

_INTERFACE = 32  # of kernels/interface.h; a library built from other sources does not serve
MEDIAN_DTYPES = (torch.uint8, torch.uint16)
FRAME_KINDS = {torch.uint8: 0, torch.uint16: 1, torch.int32: 2, torch.float32: 3}  # of kernels/pixels.h
LARGEST_MEDIAN = 31
LARGEST_MAJORITY = 15
LARGEST_CORNER_WINDOW = 15
CELLS = (1, 2, 4, 8)
WIDEST_MOMENTS = (1 << 16) - 1
COUNTED_DTYPES = (torch.uint8, torch.uint16)

_log = logging.getLogger(__name__)


class CornerPlaces(NamedTuple):
    """Points (B, count, 2) and response (B, count), float32, strongest first; NaN behind the last."""

    points: Tensor
    response: Tensor


class FittedPlanes(NamedTuple):
    """As `ops.local_fit.LocalFit` has them."""

    value: Tensor
    gradient: Tensor
    covariance: Tensor | None
    point_count: Tensor
    centroid_offset: Tensor


def serve(*tensors: Tensor | None) -> bool:
    """Whether the compiled kernels may take these tensors here and now."""
    return (
        not torch.compiler.is_compiling()  # first: a compiler would go on into the search for the library
        and _library() is not None
        and not torch.jit.is_tracing()
        and torch._C._len_torch_dispatch_stack() == 0  # nobody records or changes what the ops do
        and not torch._C._are_functorch_transforms_active()
        and all(_is_plain(tensor) for tensor in tensors if tensor is not None)
    )


def median(frames: Tensor, size: int) -> Tensor:
    """Median of uint8 or uint16 frames (B, 1, H, W), as `ops.median.median_filter` has it.

    Raises:
        TypeError, ValueError: another dtype or shape, or a size that is even or outside 3 to 31.
    """
    _check_frames(frames, MEDIAN_DTYPES)
    _check_size(size, 3)
    frames = _rows_in_one_piece(frames)
    table = None if size in COMPILED_SIZES else _table(size)
    medians = torch.empty(frames.shape, dtype=frames.dtype)
    _call(
        "fingerflow_median",
        frames.data_ptr(),
        medians.data_ptr(),
        *_extent(frames),
        frames.element_size(),
        size,
        None if table is None else ctypes.addressof(table),
        torch.get_num_threads(),
    )
    return medians


class _LitFrames(ctypes.Structure):
    """`fingerflow_lit_frames` of kernels/interface.h."""

    _fields_ = (
        ("frames", ctypes.c_void_p),
        *((name, ctypes.c_int64) for name in ("count", "image_stride", "row_stride", "kind")),
        *((name, ctypes.c_void_p) for name in ("light", "black")),
        *((name, ctypes.c_int64) for name in ("lights", "blacks", "batch", "height", "width")),
    )


def real_contact_mask(frames: Tensor, light: Tensor, black: Tensor, limits: Tensor, size: int) -> Tensor:
    """(B, 1, H, W) bool, as `ops.real_contact_mask` has it: frames of FRAME_KINDS, light and black (1 or B, 1, H, W)
    and limits (B,) float32.

    Raises:
        TypeError, ValueError: another dtype, shapes that do not fit, a size that is even or outside 1 to 15.
    """
    if not 1 <= size <= LARGEST_MAJORITY or size % 2 == 0:
        raise ValueError(f"the compiled majority has odd sizes from 1 to {LARGEST_MAJORITY}: {size} was asked for")
    _check_like("limits", limits, torch.float32, (len(frames),))
    touch, limits = torch.empty(frames.shape, dtype=torch.bool), limits.contiguous()
    _call_on_lit("fingerflow_real_contact_mask", frames, light, black, limits.data_ptr(), size, touch.data_ptr())
    return touch


def light_gain(frames: Tensor, light: Tensor, black: Tensor, side: int) -> Tensor:
    """(B,) float32, as `ops.light_gain` has it, from blocks of `side` px; tensors as for `real_contact_mask`.

    Raises:
        TypeError, ValueError: see there; a side that is no multiple of 8.
    """
    if side < 8 or side % 8:
        raise ValueError(f"blocks of {side} px: the compiled gain takes multiples of 8")
    gains = torch.empty(len(frames))
    _call_on_lit("fingerflow_light_gain", frames, light, black, side, gains.data_ptr())
    return gains


def histogram(frames: Tensor, mask: Tensor | None, bin_of_level: Tensor | None, bins: int) -> Tensor:
    """Counts (B, bins) int64 of uint8 or uint16 frames, of the pixels in mask (B or 1, 1, H, W) bool.

    `bin_of_level` holds the bin of each of the 256 or 65536 levels, uint16; without it a level is its own bin.

    Raises:
        TypeError, ValueError: another dtype or shape, or fewer bins than levels without `bin_of_level`.
    """
    _check_frames(frames, COUNTED_DTYPES)
    levels = 1 << 8 * frames.element_size()
    if bin_of_level is not None:
        _check_like("bin_of_level", bin_of_level, torch.uint16, (levels,))
        if (highest := int(bin_of_level.int().amax())) >= bins:
            raise ValueError(f"bin_of_level goes up to {highest}: there are {bins} bins, from 0 on")
    if bins < 1 or bins > 1 << 16 or (bin_of_level is None and bins < levels):
        raise ValueError(
            f"{bins} bins for {levels} levels: give 1 to 65536, and the bin of each level if they are fewer"
        )
    frames = _rows_in_one_piece(frames)
    mask = None if mask is None else _mask_of(frames, mask)
    counts = torch.empty(len(frames), bins, dtype=torch.int64)
    _call(
        "fingerflow_histogram",
        frames.data_ptr(),
        *_extent(frames),
        FRAME_KINDS[frames.dtype],
        *_mask_numbers(mask),
        None if bin_of_level is None else bin_of_level.data_ptr(),
        bins,
        counts.data_ptr(),
        torch.get_num_threads(),
    )
    return counts


def otsu_threshold(counts: Tensor, low: float, high: float) -> Tensor:
    """Otsu's threshold (B,) float64 of histograms (B, 256) int64 whose bins go from `low` to `high`."""
    _check_like("counts", counts, torch.int64, (len(counts), 256))
    thresholds = torch.empty(len(counts), dtype=torch.float64)
    counts = counts.contiguous()
    _call("fingerflow_otsu_threshold", counts.data_ptr(), len(counts), low, high, thresholds.data_ptr())
    return thresholds


def dilate(mask: Tensor, half_widths: list[int], of_background: bool) -> Tensor:
    """A mask (B, 1, H, W) bool dilated, or eroded, by an element given by the half widths of its rows.

    Raises:
        TypeError, ValueError: another dtype or shape, or rows that do not grow towards the middle.
    """
    _check_frames(mask, (torch.bool,))
    radius = len(half_widths) // 2
    upper = half_widths[: radius + 1]
    if len(half_widths) % 2 == 0 or half_widths != half_widths[::-1] or upper != sorted(upper) or upper[-1] > radius:
        raise ValueError(f"an element with rows of half widths {half_widths}: they must grow towards the middle")
    mask = _rows_in_one_piece(mask)
    dilated = torch.empty(mask.shape, dtype=torch.bool)
    numbers = (ctypes.c_int32 * len(half_widths))(*half_widths)
    _call(
        "fingerflow_dilate",
        mask.data_ptr(),
        dilated.data_ptr(),
        *_extent(mask),
        ctypes.addressof(numbers),
        radius,
        int(of_background),
        torch.get_num_threads(),
    )
    return dilated


def fill_holes(mask: Tensor) -> Tensor:
    """The mask (B, 1, H, W) bool without holes, as `ops.components` has it."""
    return _changed_mask("fingerflow_fill_holes", mask)


def largest_component(mask: Tensor) -> Tensor:
    """The largest part of the mask (B, 1, H, W) bool, as `ops.components` has it."""
    return _changed_mask("fingerflow_largest_component", mask)


class _ApparentContacts(ctypes.Structure):
    """`fingerflow_apparent_contacts` of kernels/interface.h."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("masks", "density_margin", "numbers")),
        *((name, ctypes.c_int64) for name in ("batch", "height", "width", "radius", "side")),
    )


def apparent_contact(mask: Tensor, radius: int, side: int) -> tuple[Tensor, Tensor]:
    """Density margin (B, 1, h, w) and (B, 7) covered pixels, area, centre, semi axes and angle, float32, of a mask
    (B, 1, H, W) bool on cells of `side` px of CELLS, as `ops.apparent_contact` has them.

    Raises:
        TypeError, ValueError: another dtype or shape, or cells that are not among these.
    """
    if side not in CELLS or radius < 1:
        raise ValueError(f"cells of {side} px and a radius of {radius}: the compiled region has cells of {CELLS} px")
    _check_frames(mask, (torch.bool,))
    mask = mask.contiguous()
    batch, _, height, width = mask.shape
    density_margin = torch.empty(batch, 1, -(-height // side), -(-width // side))
    numbers = torch.empty(batch, 7)
    pointers = (tensor.data_ptr() for tensor in (mask, density_margin, numbers))
    request = _ApparentContacts(*pointers, batch, height, width, radius, side)
    _call("fingerflow_apparent_contact", ctypes.addressof(request), torch.get_num_threads())
    return density_margin, numbers


def mask_moments(mask: Tensor) -> Tensor:
    """Sums (B, 6) int64 over a mask (B, 1, H, W) bool, as `ops.ellipse` has them.

    Raises:
        TypeError, ValueError: another dtype or shape, or more than WIDEST_MOMENTS columns.
    """
    moments = torch.empty(len(mask), 6, dtype=torch.int64)
    _measure_mask("fingerflow_mask_moments", mask, moments)
    return moments


def fit_ellipse(mask: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Centre (B, 2), semi axes (B, 2), angle (B,) and area (B,) float64, as `ops.ellipse` has them.

    Raises:
        TypeError, ValueError: as `mask_moments`.
    """
    numbers = torch.empty(len(mask), 6, dtype=torch.float64)
    _measure_mask("fingerflow_fit_ellipse", mask, numbers)
    return numbers[:, :2], numbers[:, 2:4], numbers[:, 4], numbers[:, 5]


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
    _check_frames(image, tuple(FRAME_KINDS))
    batch, count = len(image), points.shape[1]
    _check_like("points", points, torch.float32, (batch, count, 2))
    _check_like("variance", variance, torch.float32, (batch,))
    if inverse_warp is not None:
        _check_like("inverse_warp", inverse_warp, torch.float32, (batch, count, 2, 2))
        inverse_warp = inverse_warp.contiguous()
    _check_window(window, image)
    image, start, variance = (
        _rows_in_one_piece(image),
        points.clone(memory_format=torch.contiguous_format),
        variance.contiguous(),
    )
    described = _described(image)
    samples = torch.empty(batch, count, 3, window * window)
    table, numbers = torch.empty(batch, count, TABLE), torch.empty(batch, count, NUMBERS)
    _call(
        "fingerflow_prepare_templates",
        ctypes.addressof(described),
        *image.shape[2:],
        count,
        start.data_ptr(),
        None if inverse_warp is None else inverse_warp.data_ptr(),
        variance.data_ptr(),
        window,
        int(gain_offset),
        rounding,
        *(result.data_ptr() for result in (samples, table, numbers)),
        torch.get_num_threads(),
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


def find_templates(
    templates: tuple[Tensor, ...],
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
    _check_frames(frames, tuple(FRAME_KINDS))
    batch, count = place.shape[:2]
    if len(frames) % max(batch, 1):
        raise ValueError(f"{len(frames)} frames cannot be those of {batch} recordings")
    steps, window = len(frames) // max(batch, 1) or 1, round(templates[1].shape[-1] ** 0.5)
    kept = _in_one_piece(
        start=(templates[0], (batch, count, 2)),
        samples=(templates[1], (batch, count, 3, window * window)),
        table=(templates[2], (batch, count, TABLE)),
        numbers=(templates[3], (batch, count, NUMBERS)),
    )
    _check_like("place", place, torch.float32, (batch, count, 2))
    place = place.clone(memory_format=torch.contiguous_format)
    speed = torch.zeros_like(place) if speed is None else speed.clone(memory_format=torch.contiguous_format)
    _check_like("speed", speed, torch.float32, (batch, count, 2))
    if variance is not None:
        _check_like("variance", variance, torch.float32, (len(frames),))
        variance = variance.contiguous()
    _check_window(window, frames)
    frames = _rows_in_one_piece(frames)
    described = _described(frames)
    shape = (steps, batch, count)
    points, estimate, covariance = torch.empty(*shape, 2), torch.empty(*shape, 2), torch.empty(*shape, 2, 2)
    error, status = torch.empty(shape), torch.empty(shape, dtype=torch.uint8)
    _call(
        "fingerflow_find_templates",
        ctypes.addressof(described),
        *frames.shape[2:],
        batch,
        count,
        steps,
        window,
        rounds,
        *(tensor.data_ptr() for tensor in kept),
        None if variance is None else variance.data_ptr(),
        place.data_ptr(),
        speed.data_ptr(),
        rounding,
        forward_backward_limit,
        mismatch_limit,
        *(result.data_ptr() for result in (points, error, covariance, status, estimate)),
        torch.get_num_threads(),
    )
    return FollowedPoints(points, error, covariance, status, estimate, place, speed)


def _in_one_piece(**given: tuple[Tensor, tuple[int, ...]]) -> list[Tensor]:
    """Float32 tensors of these shapes, contiguous."""
    for name, (tensor, shape) in given.items():
        _check_like(name, tensor, torch.float32, shape)
    return [tensor.contiguous() for tensor, _ in given.values()]


def _described(frames: Tensor) -> Any:
    """`fingerflow_image` of frames with rows in one piece."""
    numbers = frames.data_ptr(), len(frames), frames.stride(0), frames.stride(2), FRAME_KINDS[frames.dtype]
    return (ctypes.c_int64 * 5)(*numbers)


def _check_window(window: int, frames: Tensor) -> None:
    if window < 5 or window % 2 == 0:
        raise ValueError(f"window must be odd and at least 5 px, not {window}")
    if min(frames.shape[2:]) < 4:
        raise ValueError(f"frames of {tuple(frames.shape[2:])} px: 4 x 4 and more are needed")


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
    _check_frames(frames, (torch.uint8,))
    _check_like("floors", floors, torch.float32, (len(frames),))
    if not 1 <= window <= LARGEST_CORNER_WINDOW or window % 2 == 0:
        raise ValueError(f"compiled corners have odd windows up to {LARGEST_CORNER_WINDOW}: {window} was asked for")
    if frames.shape[2] * frames.shape[3] >= 1 << 32:
        raise ValueError(f"a frame of {tuple(frames.shape[2:])}: compiled corners take fewer than 2^32 pixels")
    frames, floors = _rows_in_one_piece(frames), floors.contiguous()
    mask = None if mask is None else _mask_of(frames, mask)
    points, response = torch.empty(len(frames), count, 2), torch.empty(len(frames), count)
    _call(
        "fingerflow_corners",
        frames.data_ptr(),
        *_extent(frames),
        *_mask_numbers(mask),
        floors.data_ptr(),
        quality,
        window,
        border,
        count,
        min_distance,
        points.data_ptr(),
        response.data_ptr(),
        torch.get_num_threads(),
    )
    return CornerPlaces(points, response)


def local_gradients(
    points: Tensor,
    values: Tensor,
    queries: Tensor,
    noise: Tensor | None,
    *,
    radius: float,
    least_spread: float,
    minimum_points: int,
) -> FittedPlanes:
    """Planes fitted as `ops.local_fit` has it, to rounding: sums run in another order.

    Points (B, N, 2), values (B, N, C), queries (B, Q, 2) and noise (B, N, 1 or C * C) share a dtype, float32 or
    float64; a batch is that of the results, or 1.

    Raises:
        TypeError, ValueError: another dtype, or shapes that do not belong together.
    """
    given = {"points": points, "values": values, "queries": queries, "noise": noise}
    count, components = values.shape[1:]
    batches = {len(tensor) for tensor in given.values() if tensor is not None} - {1}
    if len(batches) > 1:
        raise ValueError(f"batches of {sorted(batches)}: they are equal, or 1")
    batch = batches.pop() if batches else 1
    noises = () if noise is None else (1, components**2)
    for name, tensor, rows, columns in (
        ("points", points, count, (2,)),
        ("values", values, count, (components,)),
        ("queries", queries, queries.shape[1], (2,)),
        ("noise", noise, count, noises),
    ):
        if tensor is None:
            continue
        if tensor.dtype != points.dtype or tensor.dtype not in (torch.float32, torch.float64):
            raise TypeError(f"{name} is {tensor.dtype}: all are torch.float32 or torch.float64")
        if tensor.ndim != 3 or tensor.shape[1] != rows or tensor.shape[2] not in columns:
            raise ValueError(f"{name} has shape {tuple(tensor.shape)}: (B, {rows}, {columns}) is needed")
    contiguous = [None if tensor is None else tensor.contiguous() for tensor in given.values()]
    total = queries.shape[1]
    shapes = ((components,), (components, 2), () if noise is None else (components, 2) * 2, ())
    value, gradient, covariance, offset = (points.new_empty(batch, total, *shape) for shape in shapes)
    counts = torch.empty(batch, total, dtype=torch.int64)
    request = (ctypes.c_int64 * 19)(
        *(0 if tensor is None else tensor.data_ptr() for tensor in contiguous),
        *(0 if tensor is None else len(tensor) for tensor in contiguous),
        *(batch, count, total, components, 0 if noise is None else noise.shape[2], minimum_points),
        *(value.data_ptr(), gradient.data_ptr(), 0 if noise is None else covariance.data_ptr(), offset.data_ptr()),
        counts.data_ptr(),
    )
    _call(
        "fingerflow_local_gradients",
        ctypes.addressof(request),
        radius,
        least_spread,
        int(points.dtype == torch.float64),
        torch.get_num_threads(),
    )
    return FittedPlanes(value, gradient, None if noise is None else covariance, counts, offset)


class _AreaMedians(ctypes.Structure):
    """`fingerflow_area_medians` of kernels/interface.h."""

    _fields_ = (
        *(
            (name, ctypes.c_void_p)
            for name in ("reference", "displacement", "ellipses", "covariance", "lattice", "medians", "deviations")
        ),
        *(
            (name, ctypes.c_int64)
            for name in ("batch", "reference_batch", "point_count", "positions", "measure", "minimum_points")
        ),
        *(
            (name, ctypes.c_double)
            for name in ("radius", "least_spread", "farthest", "least_ratio", "least_share", "reach", "even")
        ),
    )


def area_medians(
    reference: Tensor,
    displacement: Tensor,
    ellipses: Tensor,
    covariance: Tensor | None,
    lattice: Tensor,
    *,
    measure: int,
    minimum_points: int,
    **limits: float,
) -> tuple[Tensor, Tensor | None]:
    """Medians (B, 5) over ellipses and their deviations, as `ops.area_medians` has them to rounding; all float32.

    Reference (1 or B, N, 2), displacement (B, N, 2), ellipses (B, 6) of centre, semi axes, cosine and sine, covariance
    (B, N, 2, 2), lattice (P, 2); measure 0 to 2, limits as in kernels/interface.h.

    Raises:
        TypeError, ValueError: another dtype, or shapes that do not belong together.
    """
    batch, count = displacement.shape[:2]
    positions = len(lattice)
    _check_like("reference", reference, torch.float32, (1 if len(reference) == 1 else batch, count, 2))
    _check_like("displacement", displacement, torch.float32, (batch, count, 2))
    _check_like("ellipses", ellipses, torch.float32, (batch, 6))
    _check_like("lattice", lattice, torch.float32, (positions, 2))
    if covariance is not None:
        _check_like("covariance", covariance, torch.float32, (batch, count, 2, 2))
    if measure not in (0, 1, 2) or not positions:
        raise ValueError(f"measure {measure} of 0 to 2, {positions} positions")
    tensors = (reference, displacement, ellipses, covariance, lattice)
    given = [None if tensor is None else tensor.contiguous() for tensor in tensors]
    medians = torch.empty(batch, 5)
    deviations = None if covariance is None else torch.empty(batch, 5)
    pointers = (None if tensor is None else tensor.data_ptr() for tensor in (*given, medians, deviations))
    request = _AreaMedians(*pointers, *(batch, len(reference), count, positions, measure, minimum_points), **limits)
    _call("fingerflow_medians_over_area", ctypes.addressof(request), torch.get_num_threads())
    return medians, deviations


class _TriangleStrain(ctypes.Structure):
    """`fingerflow_triangle_strain` of kernels/interface.h."""

    _fields_ = (
        *(
            (name, ctypes.c_void_p)
            for name in ("displacement", "covariance", "in_contact", "corners", "slopes", "products", "areas", "flat")
        ),
        *((name, ctypes.c_void_p) for name in ("strain", "strain_std", "density", "energy", "forces", "own")),
        *((name, ctypes.c_int64) for name in ("batch", "point_count", "triangle_count", "measure")),
        *((name, ctypes.c_double) for name in ("direct", "between", "shear")),
    )


def triangle_strain(
    triangles: Tensor,
    slopes: Tensor,
    products: Tensor,
    areas: Tensor,
    flat: Tensor,
    displacement: Tensor,
    covariance: Tensor,
    in_contact: Tensor,
    *,
    measure: int,
    stiffness: tuple[float, float, float],
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Strain (B, M, 3), its deviation, density (B, M) and energy (B,) float64, as `ops.triangle_strain` has them to
    rounding; the forces (B, N, 2) at the points, and the sum (B,) float64 of the squares of what the error of each adds
    to the energy.

    Triangles (M, 3) int64, slopes (M, 3, 2), products (3, 3, M) xx, xy, yy of the corners' slopes with those of what
    shares their errors, areas (M,) and flat (M,), displacement (B, N, 2), covariance (B, N, 2, 2), all float32;
    in_contact (B, M) bool; measure 0 to 2, stiffness of exx^2 + eyy^2, exx eyy and exy^2.

    Raises:
        TypeError, ValueError: another dtype, shapes that do not belong together, triangles of points out of range.
    """
    batch, points = displacement.shape[:2]
    count = len(triangles)
    _check_like("triangles", triangles, torch.int64, (count, 3))
    _check_like("slopes", slopes, torch.float32, (count, 3, 2))
    _check_like("products", products, torch.float32, (3, 3, count))
    _check_like("areas", areas, torch.float32, (count,))
    _check_like("flat", flat, torch.float32, (count,))
    _check_like("displacement", displacement, torch.float32, (batch, points, 2))
    _check_like("covariance", covariance, torch.float32, (batch, points, 2, 2))
    _check_like("in_contact", in_contact, torch.bool, (batch, count))
    if measure not in (0, 1, 2) or (count and not 0 <= int(triangles.min()) <= int(triangles.max()) < points):
        raise ValueError(f"measure {measure} of 0 to 2; triangles of {points} points")
    corners = triangles.T.to(torch.int32)
    tensors = (displacement, covariance, in_contact, corners, slopes.permute(2, 1, 0), products, areas, flat)
    given = [tensor.contiguous() for tensor in tensors]
    strain, deviation, density = torch.empty(batch, count, 3), torch.empty(batch, count, 3), torch.empty(batch, count)
    energy, own = (torch.empty(batch, dtype=torch.float64) for _ in range(2))
    results = (strain, deviation, density, energy, torch.empty(batch, points, 2), own)
    pointers = (tensor.data_ptr() for tensor in (*given, *results))
    request = _TriangleStrain(*pointers, *(batch, points, count, measure), *stiffness)
    _call("fingerflow_strain_of_triangles", ctypes.addressof(request), torch.get_num_threads())
    return results


class _FlowLevel(ctypes.Structure):
    """`fingerflow_flow_level` of kernels/interface.h."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("tensor", "right", "down", "inverse", "inside")),
        *((name, ctypes.c_int64) for name in ("height", "width")),
    )


class _FlowCycles(ctypes.Structure):
    """`fingerflow_flow_cycles_of` of kernels/interface.h."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("levels", "right_side", "solution")),
        *((name, ctypes.c_int64) for name in ("count", "batch")),
        *((name, ctypes.c_int32) for name in ("cycles", "sweeps", "coarsest")),
        ("damping", ctypes.c_float),
    )


def flow_cycles(
    levels: Sequence[Sequence[Tensor]], right_side: Tensor, cycles: int, sweeps: int, coarsest: int, damping: float
) -> Tensor:
    """(B, 2, H, W), as `ops.flow_multigrid.solve` has it to rounding, of levels (tensor, right, down, inverse,
    inside), all float32.

    Raises:
        TypeError, ValueError: another dtype, or shapes that do not belong together.
    """
    batch, _, height, width = right_side.shape
    _check_like("right_side", right_side, torch.float32, (batch, 2, height, width))
    described, kept = [], []
    for tensors in levels:
        channels = ((3, 0, 0), (1, 0, -1), (1, -1, 0), (3, 0, 0), (1, 0, 0))
        for tensor, (count, rows, columns) in zip(tensors, channels, strict=True):
            _check_like("a level", tensor, torch.float32, (batch, count, height + rows, width + columns))
        planes = [tensor.contiguous() for tensor in tensors]
        kept.append(planes)
        described.append(_FlowLevel(*(plane.data_ptr() for plane in planes), height, width))
        height, width = (height + 1) // 2, (width + 1) // 2
    right_side, solution = right_side.contiguous(), torch.empty(right_side.shape)
    array = (_FlowLevel * len(described))(*described)
    pointers = (ctypes.addressof(array), right_side.data_ptr(), solution.data_ptr())
    request = _FlowCycles(*pointers, len(described), batch, cycles, sweeps, coarsest, damping)
    _call("fingerflow_flow_cycles", ctypes.addressof(request), torch.get_num_threads())
    return solution


def flow_warp(coefficients: Tensor, flow: Tensor) -> Tensor:
    """(B, 1, H, W), the spline of coefficients (B, 1, H, W) at pixels displaced by a finite flow (B, 2, H, W), float32.

    Raises:
        TypeError, ValueError: another dtype, or shapes that do not belong together.
    """
    _check_frames(coefficients, (torch.float32,))
    batch, _, height, width = coefficients.shape
    _check_like("flow", flow, torch.float32, (batch, 2, height, width))
    coefficients, flow, values = coefficients.contiguous(), flow.contiguous(), torch.empty(coefficients.shape)
    pointers = (coefficients.data_ptr(), flow.data_ptr(), values.data_ptr())
    _call("fingerflow_flow_warp", *pointers, batch, height, width, torch.get_num_threads())
    return values


class _SkinChain(ctypes.Structure):
    """`fingerflow_skin_chain` of kernels/interface.h."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("reference", "numbers", "friction", "load", "rest")),
        *((name, ctypes.c_void_p) for name in ("place", "bone", "rubbed", "step", "time", "counts", "record")),
        *((name, ctypes.c_int64) for name in ("batch", "count", "held_x", "held_z", "most_steps", "record_steps")),
        *((name, ctypes.c_double) for name in ("tolerance", "duration")),
    )


def press_skin(
    reference: Tensor,
    numbers: Tensor,
    friction: Tensor,
    load: Tensor,
    rest: Tensor,
    place: Tensor,
    bone: Tensor,
    rubbed: Tensor,
    step: Tensor,
    *,
    held: tuple[bool, bool],
    most_steps: int,
    tolerance: float,
    duration: float,
    record_steps: int = 0,
) -> tuple[Tensor, Tensor, Tensor]:
    """Goes on with B chains of N elements, as `models.skin_implicit.advance` does, to rounding; all float64, SI units.

    Reference (B, N, 2), numbers (B, 10) in the order of `models.skin_forces.Chain`, friction (B, N),
    load (B, 2, 2) first and last, rest (B,). Place (B, N, 2), bone (B, 2), rubbed (B, N) and step (B,) are changed.
    Gives time (B,), counts (B, 3) int64 of steps, rejected ones and iterations, and of up to ``record_steps`` steps
    (B, record_steps, 2 + 2 (3 N + 2)) time, length, and of both stages place, bone and friction.

    Raises:
        ValueError: another dtype, or shapes that do not belong together.
    """
    batch, count = friction.shape
    shapes = {"reference": (batch, count, 2), "numbers": (batch, 10), "load": (batch, 2, 2)}
    state = {"place": (batch, count, 2), "bone": (batch, 2), "rubbed": (batch, count), "step": (batch,)}
    given = {"reference": reference, "numbers": numbers, "friction": friction, "load": load, "rest": rest}
    changed = {"place": place, "bone": bone, "rubbed": rubbed, "step": step}
    for name, shape in {**shapes, "friction": (batch, count), "rest": (batch,), **state}.items():
        _check_like(name, {**given, **changed}[name], torch.float64, shape)
    if count < 3 or not all(tensor.is_contiguous() for tensor in changed.values()):
        raise ValueError(f"a chain of {count} elements: give 3 or more, and a state in one piece")
    kept = [tensor.contiguous() for tensor in given.values()]
    time, counts = torch.zeros(batch, dtype=torch.float64), torch.zeros(batch, 3, dtype=torch.int64)
    record = torch.zeros(batch, record_steps, 2 + 2 * (3 * count + 2), dtype=torch.float64)
    pointers = (tensor.data_ptr() for tensor in (*kept, *changed.values(), time, counts))
    request = _SkinChain(
        *pointers,
        record.data_ptr() if record_steps else None,
        *(batch, count, *held, most_steps, record_steps),
        *(tolerance, duration),
    )
    _call("fingerflow_press_skin", ctypes.addressof(request), torch.get_num_threads())
    return time, counts, record


class _SkinBack(ctypes.Structure):
    """`fingerflow_skin_back` of kernels/interface.h."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("reference", "numbers", "friction", "place", "bone", "rubbed")),
        *((name, ctypes.c_void_p) for name in ("record", "wanted", "steps", "stiffness", "of_friction", "result")),
        *((name, ctypes.c_int64) for name in ("batch", "count", "held_x", "held_z", "record_steps")),
    )


def press_skin_back(
    reference: Tensor,
    numbers: Tensor,
    friction: Tensor,
    place: Tensor,
    bone: Tensor,
    rubbed: Tensor,
    record: Tensor,
    wanted: Tensor,
    steps: Tensor,
    *,
    held: tuple[bool, bool],
) -> tuple[Tensor, Tensor, Tensor]:
    """Derivatives back along the record of `press_skin`, to rounding what `models.skin_adjoint` gives.

    Arguments as there, ``place``, ``bone`` and ``rubbed`` those at the beginning; ``wanted`` (B, 3 N + 2) of places,
    bone and friction at the end, ``steps`` (B,) int64 of the record. Gives those of stiffnesses (B, 6), of friction
    (B, N) and, as wanted, of the beginning (B, 3 N + 2).

    Raises:
        ValueError: another dtype, shapes that do not belong together, or more steps than the record has.
    """
    batch, count = friction.shape
    size, rows = 3 * count + 2, record.shape[1]
    shapes = {"reference": (batch, count, 2), "numbers": (batch, 10), "friction": (batch, count)}
    shapes |= {"place": (batch, count, 2), "bone": (batch, 2), "rubbed": (batch, count)}
    shapes |= {"record": (batch, rows, 2 + 2 * size), "wanted": (batch, size)}
    tensors = (reference, numbers, friction, place, bone, rubbed, record, wanted)
    for (name, shape), tensor in zip(shapes.items(), tensors, strict=True):
        _check_like(name, tensor, torch.float64, shape)
    _check_like("steps", steps, torch.int64, (batch,))
    if count < 3 or (batch and not 0 <= int(steps.min()) <= int(steps.max()) <= rows):
        raise ValueError(f"{count} elements, steps {steps.tolist()} of {rows}: give 3 or more, and the whole record")
    given = [tensor.contiguous() for tensor in (*tensors, steps)]
    found = [torch.empty(batch, last, dtype=torch.float64) for last in (6, count, size)]
    pointers = (tensor.data_ptr() for tensor in (*given, *found))
    request = _SkinBack(*pointers, *(batch, count, *held, rows))
    _call("fingerflow_press_skin_back", ctypes.addressof(request), torch.get_num_threads())
    return found[0], found[1], found[2]


def halve(frames: Tensor) -> Tensor:
    """Means of 2 x 2 px (B, 1, H // 2, W // 2) float32, as `ops.search` has them, of frames of FRAME_KINDS."""
    halved = torch.empty((*frames.shape[:2], frames.shape[2] // 2, frames.shape[3] // 2))
    _per_frame("fingerflow_halve", frames, halved)
    return halved


def search_windows(
    templates: Tensor, images: Tensor, image_index: Tensor, points: Tensor, guess: Tensor, size: int, reach: int
) -> Tensor:
    """Places (P, 2) as `ops.search` has them, from images (B, 1, h, w) of half resolution, all float32.

    Image_index (P,) int64, points and guess (P, 2); templates `size` wide, found up to `reach` px away.

    Raises:
        TypeError, ValueError: another dtype, shapes that do not belong together, an even size or a negative reach.
    """
    count = len(points)
    _check_frames(templates, (torch.float32,))
    _check_like("images", images, torch.float32, tuple(templates.shape))
    _check_indices(image_index, count, len(images))
    _check_like("points", points, torch.float32, (count, 2))
    _check_like("guess", guess, torch.float32, (count, 2))
    if size < 1 or size % 2 == 0 or reach < 0 or (count and min(images.shape[2:]) < 1):
        raise ValueError(f"templates {size} wide, {reach} px away, in images of {tuple(images.shape)}")
    given = [tensor.contiguous() for tensor in (templates, images, image_index, points, guess)]
    found = torch.empty(count, 2)
    _call(
        "fingerflow_search_windows",
        *(tensor.data_ptr() for tensor in given[:2]),
        *images.shape[2:],
        *(tensor.data_ptr() for tensor in given[2:]),
        count,
        size,
        reach,
        found.data_ptr(),
        torch.get_num_threads(),
    )
    return found


def mean_response(frames: Tensor) -> Tensor:
    """Mean absolute response (B,) float64 of the mask of `ops.noise`, of frames of FRAME_KINDS, at least 3 x 3."""
    means = torch.empty(len(frames), dtype=torch.float64)
    _per_frame("fingerflow_mean_response", frames, means)
    return means


def limit_instruction_set(most: int) -> int:
    """For tests: use no wider set than 0 baseline, 1 AVX2, 2 AVX-512, -1 what there is; returns the one taken."""
    library = _library()
    if library is None:
        raise RuntimeError("the compiled kernels do not serve here: build them with `pip install -e .`")
    return int(library.fingerflow_limit_instruction_set(most))


@functools.cache
def _table(size: int) -> ctypes.Array[ctypes.c_uint16]:
    numbers = median_table(size)
    return (ctypes.c_uint16 * len(numbers))(*numbers)


@functools.cache
def _library() -> ctypes.CDLL | None:
    if os.environ.get("FINGERFLOW_KERNELS", "1") == "0":
        return None
    found = importlib.util.find_spec("fingerflow._kernels")
    if found is None or found.origin is None:
        _log.info("compiled kernels were not built (no C++ compiler at install time?): portable ops serve, more slowly")
        return None
    library = ctypes.CDLL(found.origin)
    if not hasattr(library, "fingerflow_interface") or library.fingerflow_interface() != _INTERFACE:
        _log.info("%s was built from other sources: install again; portable ops serve, more slowly", found.origin)
        return None
    count: Any = ctypes.c_int64
    pointer: Any = ctypes.c_void_p
    number: Any = ctypes.c_int
    extent = [count] * 5
    library.fingerflow_limit_instruction_set.argtypes = [number]
    library.fingerflow_median.argtypes = [pointer, pointer, *extent, number, number, pointer, number]
    library.fingerflow_mean_response.argtypes = [pointer, pointer, *extent, number, number]
    real: Any = ctypes.c_float
    double: Any = ctypes.c_double
    beside = [count] * 3
    library.fingerflow_real_contact_mask.argtypes = [*[pointer] * 2, number, pointer, number]
    library.fingerflow_light_gain.argtypes = [pointer, count, pointer, number]
    library.fingerflow_histogram.argtypes = [
        *[pointer, *extent, number],
        *[pointer, *beside],
        *[pointer, count, pointer, number],
    ]
    library.fingerflow_otsu_threshold.argtypes = [pointer, count, double, double, pointer]
    library.fingerflow_corners.argtypes = [
        *[pointer, *extent],
        *[pointer, *beside],
        *[pointer, real, count, count, count, double, pointer, pointer, number],
    ]
    library.fingerflow_local_gradients.argtypes = [pointer, double, double, number, number]
    library.fingerflow_medians_over_area.argtypes = [pointer, number]
    library.fingerflow_strain_of_triangles.argtypes = [pointer, number]
    library.fingerflow_flow_cycles.argtypes = [pointer, number]
    library.fingerflow_flow_warp.argtypes = [*[pointer] * 3, *[count] * 3, number]
    library.fingerflow_press_skin.argtypes = [pointer, number]
    library.fingerflow_press_skin_back.argtypes = [pointer, number]
    library.fingerflow_dilate.argtypes = [pointer, pointer, *extent, pointer, count, number, number]
    library.fingerflow_fill_holes.argtypes = [pointer, pointer, *extent, number]
    library.fingerflow_largest_component.argtypes = [pointer, pointer, *extent, number]
    library.fingerflow_apparent_contact.argtypes = [pointer, number]
    library.fingerflow_mask_moments.argtypes = [pointer, pointer, *extent, number]
    library.fingerflow_fit_ellipse.argtypes = [pointer, pointer, *extent, number]
    library.fingerflow_halve.argtypes = [pointer, pointer, *extent, number, number]
    library.fingerflow_search_windows.argtypes = [
        *[pointer] * 2,
        *[count] * 2,
        *[pointer] * 3,
        count,
        *[number] * 2,
        pointer,
        number,
    ]
    library.fingerflow_prepare_templates.argtypes = [
        *[pointer, *[count] * 3],
        *[pointer] * 3,
        *[number, number, real],
        *[pointer] * 3,
        number,
    ]
    library.fingerflow_find_templates.argtypes = [
        *[pointer, *[count] * 5],
        *[number] * 2,
        *[pointer] * 7,
        *[real] * 3,
        *[pointer] * 5,
        number,
    ]
    return library


def _changed_mask(name: str, mask: Tensor, *settings: int) -> Tensor:
    _check_frames(mask, (torch.bool,))
    mask = _rows_in_one_piece(mask)
    changed = torch.empty(mask.shape, dtype=torch.bool)
    _call(name, mask.data_ptr(), changed.data_ptr(), *_extent(mask), *settings, torch.get_num_threads())
    return changed


def _measure_mask(name: str, mask: Tensor, numbers: Tensor) -> None:
    _check_frames(mask, (torch.bool,))
    if mask.shape[3] > WIDEST_MOMENTS:
        raise ValueError(f"a mask {mask.shape[3]} px wide: the compiled moments end at {WIDEST_MOMENTS} px")
    mask = _rows_in_one_piece(mask)
    _call(name, mask.data_ptr(), numbers.data_ptr(), *_extent(mask), torch.get_num_threads())


def _per_frame(name: str, frames: Tensor, result: Tensor) -> None:
    _check_frames(frames, tuple(FRAME_KINDS))
    if min(frames.shape[2:]) < 3:
        raise ValueError(f"frames of {tuple(frames.shape[2:])} px: this compiled kernel needs at least 3 x 3")
    frames = _rows_in_one_piece(frames)
    _call(
        name,
        frames.data_ptr(),
        result.data_ptr(),
        *_extent(frames),
        FRAME_KINDS[frames.dtype],
        torch.get_num_threads(),
    )


def _call(name: str, *arguments: int | float | None) -> None:
    if getattr(_library(), name)(*arguments):
        raise MemoryError(f"{name}: the system gave no memory or no thread; use smaller batches or fewer threads")


def _is_plain(tensor: Tensor) -> bool:
    return (
        type(tensor) is Tensor
        and tensor.device.type == "cpu"
        and tensor.layout == torch.strided
        and not (tensor.requires_grad and torch.is_grad_enabled())
    )


def _check_frames(frames: Tensor, dtypes: tuple[torch.dtype, ...]) -> None:
    if frames.dtype not in dtypes:
        raise TypeError(f"frames are {frames.dtype}: this compiled kernel takes {' or '.join(map(str, dtypes))}")
    if frames.ndim != 4 or frames.shape[1] != 1:
        raise ValueError(f"frames have shape {tuple(frames.shape)}: give (B, 1, H, W)")


def _check_size(size: int, least: int) -> None:
    if not least <= size <= LARGEST_MEDIAN or size % 2 == 0:
        raise ValueError(f"the compiled median has odd sizes from {least} to {LARGEST_MEDIAN}: {size} was asked for")


def _call_on_lit(name: str, frames: Tensor, light: Tensor, black: Tensor, *arguments: int | float | None) -> None:
    """Frames and the light behind them, checked, pixels of a row neighbours in memory."""
    _check_frames(frames, tuple(FRAME_KINDS))
    for image in (light, black):
        _check_frames(image, (torch.float32,))
        if image.shape[1:] != frames.shape[1:] or image.shape[0] not in (1, frames.shape[0]):
            raise ValueError(f"an image of {tuple(image.shape)} beside frames of {tuple(frames.shape)}")
    frames, light, black = _rows_in_one_piece(frames), light.contiguous(), black.contiguous()
    described = (frames.data_ptr(), len(frames), frames.stride(0), frames.stride(2), FRAME_KINDS[frames.dtype])
    images = (light.data_ptr(), black.data_ptr(), len(light), len(black))
    request = _LitFrames(*described, *images, len(frames), *frames.shape[2:])
    _call(name, ctypes.addressof(request), *arguments, torch.get_num_threads())


def _mask_of(frames: Tensor, mask: Tensor) -> Tensor:
    """The mask (B or 1, 1, H, W) bool of frames, checked, pixels of a row neighbours in memory."""
    _check_frames(mask, (torch.bool,))
    if mask.shape[1:] != frames.shape[1:] or len(mask) not in (1, len(frames)):
        raise ValueError(f"a mask of {tuple(mask.shape)} beside frames of {tuple(frames.shape)}")
    return _rows_in_one_piece(mask)


def _mask_numbers(mask: Tensor | None) -> tuple[int | None, int, int, int]:
    """Data, number of images, strides of an image and of a row."""
    return (None, 0, 0, 0) if mask is None else (mask.data_ptr(), len(mask), mask.stride(0), mask.stride(2))


def _check_like(name: str, tensor: Tensor, dtype: torch.dtype, shape: tuple[int, ...]) -> None:
    if tensor.dtype != dtype or tuple(tensor.shape) != shape:
        raise ValueError(f"{name} is {tensor.dtype} {tuple(tensor.shape)}: {dtype} {shape} is needed")


def _check_indices(image_index: Tensor, count: int, images: int) -> None:
    _check_like("image_index", image_index, torch.int64, (count,))
    if count and not 0 <= int(image_index.min()) <= int(image_index.max()) < images:
        raise ValueError(f"image_index goes from {image_index.min()} to {image_index.max()} of {images}")


def _rows_in_one_piece(frames: Tensor) -> Tensor:
    """The frames themselves where pixels of a row are neighbours in memory, else a copy."""
    one_piece = frames.stride(3) == 1 or frames.shape[3] == 1
    return frames if one_piece else frames.contiguous()


def _extent(frames: Tensor) -> tuple[int, int, int, int, int]:
    """Batch, height, width, and the strides of a frame and of a row in pixels."""
    batch, _, height, width = frames.shape
    return batch, height, width, frames.stride(0), frames.stride(2)
