"""Kernels of the contact: medians, masks, thresholds, components, ellipses."""

import ctypes
import functools
from collections.abc import Sequence

import torch
from torch import Tensor

from fingerflow.kernels.checks import (
    FRAME_KINDS,
    check_frames,
    check_like,
    described,
    described_mask,
    empty,
    extent,
    mask_of,
    rows_in_one_piece,
)
from fingerflow.kernels.library import entry, values_are_known
from fingerflow.kernels.torch_op import torch_op
from fingerflow.ops.median_rows import COMPILED_SIZES, median_table

__all__ = [
    "CELLS",
    "COUNTED_DTYPES",
    "LARGEST_MAJORITY",
    "LARGEST_MEDIAN",
    "MEDIAN_DTYPES",
    "WIDEST_MOMENTS",
    "apparent_contact",
    "dilate",
    "fill_holes",
    "fit_ellipse",
    "histogram",
    "largest_component",
    "light_gain",
    "mask_moments",
    "median",
    "normalize",
    "otsu_threshold",
    "real_contact_mask",
]

MEDIAN_DTYPES = (torch.uint8, torch.uint16)
LARGEST_MEDIAN = 31
LARGEST_MAJORITY = 15
CELLS = (1, 2, 4, 8)
WIDEST_MOMENTS = (1 << 16) - 1
COUNTED_DTYPES = (torch.uint8, torch.uint16)


@torch_op()
def median(frames: Tensor, size: int) -> Tensor:
    """Median of uint8 or uint16 frames (B, 1, H, W), as `ops.median.median_filter` has it.

    Raises:
        TypeError, ValueError: another dtype or shape, or a size that is even or outside 3 to 31.
    """
    check_frames(frames, MEDIAN_DTYPES)
    if not 3 <= size <= LARGEST_MEDIAN or size % 2 == 0:
        raise ValueError(f"the compiled median has odd sizes from 3 to {LARGEST_MEDIAN}: {size} was asked for")
    frames = rows_in_one_piece(frames)
    medians = empty(frames.dtype, *frames.shape)
    entry("median")(
        frames=frames,
        medians=medians,
        **extent(frames),
        pixel_bytes=frames.element_size(),
        size=size,
        table=None if size in COMPILED_SIZES else ctypes.addressof(_table(size)),
        threads=torch.get_num_threads(),
    )
    return medians


@functools.cache
def _table(size: int) -> ctypes.Array[ctypes.c_uint16]:
    numbers = median_table(size)
    return (ctypes.c_uint16 * len(numbers))(*numbers)


@torch_op()
def real_contact_mask(frames: Tensor, light: Tensor, black: Tensor, limits: Tensor, size: int) -> Tensor:
    """(B, 1, H, W) bool, as `ops.real_contact_mask` has it: frames of FRAME_KINDS, light and black (1 or B, 1, H, W)
    and limits (B,) float32.

    Raises:
        TypeError, ValueError: another dtype, shapes that do not fit, a size that is even or outside 1 to 15.
    """
    if not 1 <= size <= LARGEST_MAJORITY or size % 2 == 0:
        raise ValueError(f"the compiled majority has odd sizes from 1 to {LARGEST_MAJORITY}: {size} was asked for")
    check_like("limits", limits, torch.float32, (frames.shape[0],))
    mask, limits = empty(torch.bool, *frames.shape), limits.contiguous()
    _on_lit("real_contact_mask", frames, light, black, limits=limits, size=size, real_contact_mask=mask)
    return mask


@torch_op()
def light_gain(frames: Tensor, light: Tensor, black: Tensor, side: int) -> Tensor:
    """(B,) float32, as `ops.light_gain` has it, from blocks of `side` px; tensors as for `real_contact_mask`.

    Raises:
        TypeError, ValueError: see there; a side that is no multiple of 8.
    """
    if side < 8 or side % 8:
        raise ValueError(f"blocks of {side} px: the compiled gain takes multiples of 8")
    gains = empty(torch.float32, frames.shape[0])
    _on_lit("light_gain", frames, light, black, side=side, gains=gains)
    return gains


def _on_lit(name: str, frames: Tensor, light: Tensor, black: Tensor, **arguments: Tensor | int) -> None:
    """Frames and the light behind them, checked, pixels of a row neighbours in memory."""
    check_frames(frames, tuple(FRAME_KINDS))
    for image in (light, black):
        check_frames(image, (torch.float32,))
        if image.shape[1:] != frames.shape[1:] or image.shape[0] not in (1, frames.shape[0]):
            raise ValueError(f"an image of {tuple(image.shape)} beside frames of {tuple(frames.shape)}")
    frames, light, black = rows_in_one_piece(frames), light.contiguous(), black.contiguous()
    batch, _, height, width = frames.shape
    entry(name)(
        **described(frames),
        light=light,
        black=black,
        lights=light.shape[0],
        blacks=black.shape[0],
        batch=batch,
        height=height,
        width=width,
        **arguments,
        threads=torch.get_num_threads(),
    )


@torch_op()
def normalize(frames: Tensor, light: Tensor, black: Tensor, least: Tensor) -> tuple[Tensor, Tensor]:
    """Quotients float32 and where they are known, bool, both (B, 1, H, W), as `ops.illumination` has them: of frames of
    FRAME_KINDS, light and black as for `real_contact_mask`, lit where light exceeds least, (1 or B,) float32.

    Raises:
        TypeError, ValueError: another dtype, or shapes that do not fit.
    """
    check_like("least", least, torch.float32, (light.shape[0],))
    quotients, known = empty(torch.float32, *frames.shape), empty(torch.bool, *frames.shape)
    _on_lit("normalize", frames, light, black, least=least.contiguous(), quotients=quotients, known=known)
    return quotients, known


@torch_op()
def histogram(frames: Tensor, mask: Tensor | None, bin_of_level: Tensor | None, bins: int) -> Tensor:
    """Counts (B, bins) int64 of uint8 or uint16 frames, of the pixels in mask (B or 1, 1, H, W) bool.

    `bin_of_level` holds the bin of each of the 256 or 65536 levels, uint16; without it a level is its own bin.

    Raises:
        TypeError, ValueError: another dtype or shape, or fewer bins than levels without `bin_of_level`.
    """
    check_frames(frames, COUNTED_DTYPES)
    levels = 1 << 8 * frames.element_size()
    if bin_of_level is not None:
        check_like("bin_of_level", bin_of_level, torch.uint16, (levels,))
        if values_are_known() and (highest := int(bin_of_level.int().amax())) >= bins:
            raise ValueError(f"bin_of_level goes up to {highest}: there are {bins} bins, from 0 on")
        bin_of_level = bin_of_level.contiguous()
    if bins < 1 or bins > 1 << 16 or (bin_of_level is None and bins < levels):
        raise ValueError(
            f"{bins} bins for {levels} levels: give 1 to 65536, and the bin of each level if they are fewer"
        )
    frames = rows_in_one_piece(frames)
    mask = None if mask is None else mask_of(frames, mask)
    counts = empty(torch.int64, frames.shape[0], bins)
    entry("histogram")(
        frames=frames,
        **extent(frames),
        kind=FRAME_KINDS[frames.dtype],
        **described_mask(mask),
        bins=bin_of_level,
        count=bins,
        counts=counts,
        threads=torch.get_num_threads(),
    )
    return counts


@torch_op()
def otsu_threshold(counts: Tensor, low: float, high: float) -> Tensor:
    """Otsu's threshold (B,) float64 of histograms (B, 256) int64 whose bins go from `low` to `high`.

    Raises:
        ValueError: another dtype or shape.
    """
    batch = counts.shape[0]
    check_like("counts", counts, torch.int64, (batch, 256))
    thresholds, counts = empty(torch.float64, batch), counts.contiguous()
    entry("otsu_threshold")(counts=counts, batch=batch, low=low, high=high, thresholds=thresholds)
    return thresholds


@torch_op()
def dilate(mask: Tensor, half_widths: Sequence[int], of_background: bool) -> Tensor:
    """A mask (B, 1, H, W) bool dilated, or eroded, by an element given by the half widths of its rows.

    Raises:
        TypeError, ValueError: another dtype or shape, or rows that do not grow towards the middle.
    """
    check_frames(mask, (torch.bool,))
    rows, radius = list(half_widths), len(half_widths) // 2
    upper = rows[: radius + 1]
    if len(rows) % 2 == 0 or rows != rows[::-1] or upper != sorted(upper) or upper[-1] > radius:
        raise ValueError(f"an element with rows of half widths {rows}: they must grow towards the middle")
    mask = rows_in_one_piece(mask)
    dilated = empty(torch.bool, *mask.shape)
    numbers = (ctypes.c_int32 * len(rows))(*rows)
    entry("dilate")(
        masks=mask,
        dilated=dilated,
        **extent(mask),
        half_widths=ctypes.addressof(numbers),
        radius=radius,
        of_background=of_background,
        threads=torch.get_num_threads(),
    )
    return dilated


@torch_op()
def fill_holes(mask: Tensor) -> Tensor:
    """The mask (B, 1, H, W) bool without holes, as `ops.components` has it.

    Raises:
        TypeError, ValueError: another dtype or shape.
    """
    check_frames(mask, (torch.bool,))
    mask = rows_in_one_piece(mask)
    filled = empty(torch.bool, *mask.shape)
    entry("fill_holes")(masks=mask, filled=filled, **extent(mask), threads=torch.get_num_threads())
    return filled


@torch_op()
def largest_component(mask: Tensor) -> Tensor:
    """The largest part of the mask (B, 1, H, W) bool, as `ops.components` has it.

    Raises:
        TypeError, ValueError: another dtype or shape.
    """
    check_frames(mask, (torch.bool,))
    mask = rows_in_one_piece(mask)
    largest = empty(torch.bool, *mask.shape)
    entry("largest_component")(masks=mask, largest=largest, **extent(mask), threads=torch.get_num_threads())
    return largest


@torch_op()
def apparent_contact(mask: Tensor, radius: int, side: int) -> tuple[Tensor, Tensor]:
    """Signed density margin (B, 1, h, w) and (B, 7) covered pixels, area, centre, semi axes and angle, float32, of a
    mask (B, 1, H, W) bool on cells of `side` px of CELLS, as `ops.apparent_contact` has them.

    Raises:
        TypeError, ValueError: another dtype or shape, or cells that are not among these.
    """
    if side not in CELLS or radius < 1:
        raise ValueError(f"cells of {side} px and a radius of {radius}: the compiled region has cells of {CELLS} px")
    check_frames(mask, (torch.bool,))
    mask = mask.contiguous()
    batch, _, height, width = mask.shape
    density_margin = empty(torch.float32, batch, 1, -(-height // side), -(-width // side))
    numbers = empty(torch.float32, batch, 7)
    entry("apparent_contact")(
        masks=mask,
        density_margin=density_margin,
        numbers=numbers,
        batch=batch,
        height=height,
        width=width,
        radius=radius,
        side=side,
        threads=torch.get_num_threads(),
    )
    return density_margin, numbers


@torch_op()
def mask_moments(mask: Tensor) -> Tensor:
    """Sums (B, 6) int64 over a mask (B, 1, H, W) bool, as `ops.ellipse` has them.

    Raises:
        TypeError, ValueError: another dtype or shape, or more than WIDEST_MOMENTS columns.
    """
    mask = _narrow_mask(mask)
    moments = empty(torch.int64, mask.shape[0], 6)
    entry("mask_moments")(masks=mask, moments=moments, **extent(mask), threads=torch.get_num_threads())
    return moments


@torch_op()
def fit_ellipse(mask: Tensor) -> Tensor:
    """(B, 6) float64, as `ops.ellipse` has it: centre x and y, semi axes, major first, angle and area.

    Raises:
        TypeError, ValueError: as `mask_moments`.
    """
    mask = _narrow_mask(mask)
    ellipses = empty(torch.float64, mask.shape[0], 6)
    entry("fit_ellipse")(masks=mask, ellipses=ellipses, **extent(mask), threads=torch.get_num_threads())
    return ellipses


def _narrow_mask(mask: Tensor) -> Tensor:
    check_frames(mask, (torch.bool,))
    if mask.shape[3] > WIDEST_MOMENTS:
        raise ValueError(f"a mask {mask.shape[3]} px wide: the compiled moments end at {WIDEST_MOMENTS} px")
    return rows_in_one_piece(mask)
