"""Kernels of the contact view: median, contact mask, illumination gain, histogram, Otsu threshold, apparent contact."""

import functools

import numpy as np
from numpy.typing import NDArray

from fingerflow.kernels.arrays import Array, empty, in_one_piece, kind, range_of, rows_in_one_piece
from fingerflow.kernels.checks import (
    check_frames,
    checked,
    described,
    described_mask,
    lit,
    mask_of,
)
from fingerflow.kernels.library import entry, threads, values_are_known
from fingerflow.kernels.median_rows import COMPILED_SIZES, median_table

MEDIAN_KINDS = ("uint8", "uint16")
LARGEST_MEDIAN = 31
LARGEST_MAJORITY = 15
LARGEST_RADIUS = 255  # px, largest radius of a morphological operation in the compiled kernel
CELLS = (1, 2, 4, 8)
COUNTED_LEVELS = {"uint8": 1 << 8, "uint16": 1 << 16}


def median(frames: Array, size: int) -> Array:
    """Compute the median filter of uint8 or uint16 frames (B, 1, H, W), as `ops.filters.median.median_filter`.

    Raises:
        TypeError, ValueError: wrong dtype or shape, or a size that is even or outside 3 to 31.
    """
    check_frames(frames, MEDIAN_KINDS)
    if not 3 <= size <= LARGEST_MEDIAN or size % 2 == 0:
        raise ValueError(f"the compiled median has odd sizes from 3 to {LARGEST_MEDIAN}: {size} was asked for")
    frames = rows_in_one_piece(frames)
    medians = empty(frames, kind(frames), *frames.shape)
    entry("median")(
        **described(frames),
        medians=medians,
        size=size,
        table=table_of(int(size)),  # `int` because the torch compiler passes a symbolic size
        threads=threads(),
    )
    return medians


@functools.cache
def table_of(size: int) -> NDArray[np.uint16] | None:
    """Return the instruction table by which the compiled median filter computes windows of `size` x `size` px; None if
    no table is needed.

    No table is needed for size 1 and for sizes with a compiled program.
    """
    return None if size == 1 or size in COMPILED_SIZES else np.array(median_table(size), np.uint16)


def real_contact_mask(frames: Array, light: Array, black: Array, limits: Array, size: int) -> Array:
    """Compute the mask of real contact (B, 1, H, W) bool, skin that touches the glass: pixels darker than `black` +
    `limits` * `light`, after a majority filter of `size` x `size` px.

    Frames are of FRAME_KINDS; `light` and `black` (1 or B, 1, H, W) and `limits` (B,) are float32.

    Raises:
        TypeError, ValueError: wrong dtype, inconsistent shapes, a size that is even or outside 1 to 15.
    """
    if not 1 <= size <= LARGEST_MAJORITY or size % 2 == 0:
        raise ValueError(f"the compiled majority has odd sizes from 1 to {LARGEST_MAJORITY}: {size} was asked for")
    given = lit(frames, light, black)
    limits = checked("limits", limits, "float32", (frames.shape[0],))
    mask = empty(frames, "bool", *frames.shape)
    entry("real_contact_mask")(**given, limits=limits, size=size, real_contact_mask=mask, threads=threads())
    return mask


def illumination_gain(frames: Array, light: Array, black: Array, side: int) -> Array:
    """Compute the illumination gain (B,) float32, the ratio of each frame's light to that of the empty glass where no
    skin touches, from blocks of `side` px, as `ops.contact.illumination_gain`.

    Arrays are as for `real_contact_mask`.

    Raises:
        TypeError, ValueError: wrong dtype, inconsistent shapes, a side that is no multiple of 8.
    """
    if side < 8 or side % 8:
        raise ValueError(f"blocks of {side} px: the compiled gain takes multiples of 8")
    given, gains = lit(frames, light, black), empty(frames, "float32", frames.shape[0])
    entry("illumination_gain")(**given, side=side, gains=gains, threads=threads())
    return gains


def normalize(frames: Array, light: Array, black: Array, least: Array) -> tuple[Array, Array]:
    """Divide frames, less the black level, by the light of the empty glass; return the quotients and a mask of the
    pixels that have one, where the glass is lit.

    Both are (B, 1, H, W), as in `ops.filters.illumination`. Frames are of FRAME_KINDS, `light` and `black` as for
    `real_contact_mask`. A pixel is lit if its light exceeds `least`, float32, one per image of light.

    Raises:
        TypeError, ValueError: wrong dtype, or inconsistent shapes.
    """
    given = lit(frames, light, black)
    least = checked("least", least, "float32", (light.shape[0],))
    quotients, known = empty(frames, "float32", *frames.shape), empty(frames, "bool", *frames.shape)
    entry("normalize")(**given, least=least, quotients=quotients, known=known, threads=threads())
    return quotients, known


def histogram(frames: Array, mask: Array | None, bin_of_level: Array | None, bins: int) -> Array:
    """Compute grey-level histograms (B, bins) int64 of uint8 or uint16 frames (B, 1, H, W), from all pixels or from
    those inside a mask (B or 1, 1, H, W) bool.

    `bin_of_level` holds the bin of each of the 256 or 65536 levels, uint16; without it a level is its own bin.

    Raises:
        TypeError, ValueError: wrong dtype or shape, or fewer bins than levels without `bin_of_level`.
    """
    check_frames(frames, tuple(COUNTED_LEVELS))
    levels = COUNTED_LEVELS[kind(frames)]
    if bin_of_level is not None:
        bin_of_level = checked("bin_of_level", bin_of_level, "uint16", (levels,))
        if values_are_known() and (highest := range_of(bin_of_level)[1]) >= bins:
            raise ValueError(f"bin_of_level goes up to {highest}: there are {bins} bins, from 0 on")
    if bins < 1 or bins > 1 << 16 or (bin_of_level is None and bins < levels):
        raise ValueError(
            f"{bins} bins for {levels} levels: give 1 to 65536, and the bin of each level if they are fewer"
        )
    frames, counts = rows_in_one_piece(frames), empty(frames, "int64", frames.shape[0], bins)
    entry("histogram")(
        **described(frames),
        **described_mask(None if mask is None else mask_of(frames, mask)),
        bins=bin_of_level,
        count=bins,
        counts=counts,
        threads=threads(),
    )
    return counts


def apparent_contact(mask: Array, radius: int, side: int) -> tuple[Array, Array]:
    """Compute size and shape of the apparent contact, the whole region covered by ridges and valleys, and its density
    margin, the local density of real contact above that at the border, from a mask (B, 1, H, W).

    The method is that of `ops.contact.apparent_contact`. The results are float32: the signed density margin (B, 1, h,
    w), and (B, 7) covered pixels, area, centre, semi axes and angle. `side` is one of CELLS.

    Raises:
        TypeError, ValueError: wrong dtype or shape, or cells that are not among these.
    """
    if side not in CELLS or not 1 <= radius <= LARGEST_RADIUS:
        raise ValueError(
            f"cells of {side} px and a radius of {radius}: the compiled region has cells of {CELLS} px, and "
            f"a radius of 1 to {LARGEST_RADIUS}"
        )
    check_frames(mask, ("bool",))
    mask = in_one_piece(mask)
    batch, _, height, width = mask.shape
    density_margin = empty(mask, "float32", batch, 1, -(-height // side), -(-width // side))
    numbers = empty(mask, "float32", batch, 7)
    entry("apparent_contact")(
        masks=mask,
        density_margin=density_margin,
        numbers=numbers,
        batch=batch,
        height=height,
        width=width,
        radius=radius,
        side=side,
        threads=threads(),
    )
    return density_margin, numbers
