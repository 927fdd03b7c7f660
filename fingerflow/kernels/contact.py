"""Kernels of the contact view: median, contact mask, illumination gain, histogram, apparent contact, its threshold.

Frames (B, 1, H, W) are of `declarations.FRAME_KINDS`, other images and numbers per frame float32. What does not fit the
declaration of a kernel raises TypeError (wrong dtype) or ValueError.
"""

import functools

import numpy as np
from numpy.typing import NDArray

from fingerflow.kernels.arrays import KINDS, Array
from fingerflow.kernels.contact_sizes import cell_of
from fingerflow.kernels.library import compiled
from fingerflow.kernels.median_rows import COMPILED_SIZES, median_table

LARGEST_MEDIAN = 31
LARGEST_MAJORITY = 15
CELLS = (1, 2, 4, 8)
COUNTED_LEVELS = {"uint8": 1 << 8, "uint16": 1 << 16}


def median(frames: Array, size: int) -> Array:
    """Compute the median filter of uint8 or uint16 frames over windows of `size` x `size` px, odd and 3 to 31, as
    `ops.filters.median.median_filter`.
    """
    # The compiler of torch gives a symbolic size, which no cache takes.
    return compiled("median")(frames=frames, size=size, table=table_of(int(size)))


@functools.cache
def table_of(size: int) -> NDArray[np.uint16] | None:
    """Return the instruction table by which the compiled median filter computes windows of `size` x `size` px; None if
    no table is needed.

    No table is needed for size 1 and for sizes with a compiled program.
    """
    return None if size == 1 or size in COMPILED_SIZES else np.array(median_table(size), np.uint16)


def histogram(frames: Array, mask: Array | None, bin_of_level: Array | None, bins: int) -> Array:
    """Compute grey-level histograms (B, bins) int64 of uint8 or uint16 frames (B, 1, H, W), from all pixels or from
    those inside a mask (B or 1, 1, H, W) bool.

    `bin_of_level` holds the bin of each of the 256 or 65536 levels, uint16; without it a level is its own bin, and
    there must be as many bins.
    """
    levels = COUNTED_LEVELS.get(KINDS[frames.dtype], 0)
    if levels > (bins if bin_of_level is None else bin_of_level.shape[0]):
        raise ValueError(f"{bins} bins for {levels} levels: give the bin of each level if bins are fewer than these")
    return compiled("histogram")(frames=frames, mask=mask, bins=bin_of_level, count=bins)


def contact_threshold(
    frames: Array, light: Array, black: Array, gains: Array | None, *, median_px: int, radius: int, stride_px: int
) -> Array:
    """Measure the contact threshold (K,): the intensity loss relative to the empty glass at the edges of ridges in
    contact, as `ops.contact.contact_threshold`; NaN without contact.

    `gains` are illumination gains (K,); NaN or None stands for 1. Lines are read, and pixels
    counted, in steps of `stride_px`.
    """
    sizes = {"size": median_px, "table": table_of(median_px), "radius": radius, "side": cell_of(radius)}
    images = {"frames": frames, "light": light, "black": black}
    gain = np.ones(frames.shape[0], np.float32) if gains is None else gains
    return compiled("contact_threshold")(**images, gains=gain, **sizes, stride=stride_px)
