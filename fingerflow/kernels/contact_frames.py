"""Kernels for the contact of whole frames, on NumPy arrays: segmentation, threshold, and points in contact."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fingerflow.kernels.checks import checked, lit
from fingerflow.kernels.contact import CELLS, LARGEST_MAJORITY, LARGEST_RADIUS, table_of
from fingerflow.kernels.contact_sizes import block_of, cell_of
from fingerflow.kernels.library import entry, threads

Array = NDArray[Any]


class ContactOfFrames(NamedTuple):
    """Contact mask, areas, ellipse and illumination gain of K frames.

    Attributes:
        real_contact_mask: (K, 1, H, W) bool, the micro-junctions.
        density_margin: (K, 1, h, w) float32 of the apparent contact on cells, an input of `covered`.
        numbers: (K, 7) float32: real and apparent area, px; centre x and y and semi axes, px, and angle, rad, NaN
            without contact.
        gains: (K,) float32, illumination gain relative to the empty glass; NaN where no glass is visible.
    """

    real_contact_mask: Array
    density_margin: Array
    numbers: Array
    gains: Array


def contact_of_frames(
    frames: Array, light: Array, black: Array, limits: Array, *, median_px: int, radius: int, cell: int
) -> ContactOfFrames:
    """Compute contact mask, areas, ellipse and illumination gain of frames in one call, as `graphs.ContactGraph`.

    The mask contains the pixels below black + limit * gain * light; an unknown gain counts as 1.

    Args:
        frames: (K, 1, H, W) of FRAME_KINDS.
        light, black: (1 or K, 1, H, W) float32, counts of the empty glass above black, 0 where it is not lit, and
            counts without light.
        limits: (K,) float32, share of the light below which a pixel touches; with NaN no pixel does.
        median_px: odd side of the median, up to 15.
        radius: px of the apparent contact.
        cell: px, side of its cells, one of CELLS.

    Raises:
        TypeError, ValueError: wrong dtype, inconsistent shapes or sizes.
    """
    _check_sizes(median_px, radius)
    if cell not in CELLS or cell > 2 * radius + 1:
        raise ValueError(f"cells of {cell} px and a radius of {radius}: give cells of {CELLS} px, no wider than boxes")
    given = _lit(frames, light, black)
    batch, _, height, width = frames.shape
    limits = checked("limits", limits, "float32", (batch,))
    found = ContactOfFrames(
        np.empty(frames.shape, np.bool_),
        np.empty((batch, 1, -(-height // cell), -(-width // cell)), np.float32),
        np.empty((batch, 7), np.float32),
        np.empty(batch, np.float32),
    )
    entry("contact_of_frames")(
        **given,
        limits=limits,
        size=median_px,
        block=block_of(radius),
        radius=radius,
        side=cell,
        **found._asdict(),
        threads=threads(),
    )
    return found


def contact_threshold(
    frames: Array,
    light: Array,
    black: Array,
    gains: Array | None = None,
    *,
    median_px: int,
    radius: int,
    stride_px: int,
) -> Array:
    """Measure the contact threshold (K,) float32: the intensity loss at the edges of ridges in contact.

    The loss is relative to the empty glass. The threshold is computed as by `ops.contact.contact_threshold`, and NaN
    without contact.

    Args:
        frames, light, black, median_px, radius: as for `contact_of_frames`.
        gains: (K,) float32, illumination gains; NaN or None for 1.
        stride_px: step between the lines that are read, and between the pixels of Otsu's histogram.

    Raises:
        TypeError, ValueError: wrong dtype, inconsistent shapes or sizes.
    """
    _check_sizes(median_px, radius)
    if stride_px < 1:
        raise ValueError(f"one pixel of {stride_px} counted: give 1 for all, or more")
    given, batch = _lit(frames, light, black), len(frames)
    gains = np.ones(batch, np.float32) if gains is None else checked("gains", gains, "float32", (batch,))
    thresholds = np.empty(batch, np.float32)
    entry("contact_threshold")(
        **given,
        gains=gains,
        size=median_px,
        table=table_of(median_px),
        radius=radius,
        side=cell_of(radius),
        stride=stride_px,
        thresholds=thresholds,
        threads=threads(),
    )
    return thresholds


def covered(density_margin: Array, points: Array, transform: Array, cell: int) -> Array:
    """Return a mask (K, N) bool of the points that lie inside the apparent contact of their frame, as
    `ops.contact.cells.covered`.

    A point at the border (a margin of 0), to rounding, may be covered here and not there.

    Args:
        density_margin: (K, 1, h, w) float32 of `contact_of_frames`, on cells of `cell` px.
        points: (K, N, 2) float32, in the pixels of another view; one that is not finite is not covered.
        transform: (2, 3) float32, to the pixels of the contact view.

    Raises:
        ValueError: wrong dtype, or inconsistent shapes.
    """
    if density_margin.ndim != 4 or density_margin.shape[1] != 1 or 0 in density_margin.shape[2:] or cell < 1:
        raise ValueError(
            f"density_margin of {density_margin.shape}, on cells of {cell} px: give (K, 1, h, w), none of them 0"
        )
    batch, _, down, across = density_margin.shape
    density_margin = checked("density_margin", density_margin, "float32", density_margin.shape)
    points = checked("points", points, "float32", (batch, *points.shape[1:2], 2))
    transform, count = checked("transform", transform, "float32", (2, 3)), points.shape[1]
    found = np.empty((batch, count), np.bool_)
    entry("covered")(
        density_margin=density_margin,
        batch=batch,
        down=down,
        across=across,
        side=cell,
        points=points,
        count=count,
        transform=transform,
        covered=found,
    )
    return found


def _check_sizes(median_px: int, radius: int) -> None:
    if not 1 <= median_px <= LARGEST_MAJORITY or median_px % 2 == 0:
        raise ValueError(f"a median of {median_px} px: the compiled contact has odd sizes from 1 to {LARGEST_MAJORITY}")
    if not 1 <= radius <= LARGEST_RADIUS:
        raise ValueError(f"a radius of {radius} px: give 1 to {LARGEST_RADIUS}")


def _lit(frames: Array, light: Array, black: Array) -> dict[str, Any]:
    if 0 in frames.shape[2:]:
        raise ValueError(f"frames have shape {frames.shape}: there is no pixel")
    return lit(frames, light, black)
