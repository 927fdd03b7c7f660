"""Light of the empty glass, and points in the apparent contact, the same for every engine."""

from __future__ import annotations

import math

import numpy as np

from fingerflow.engines.engine import Array, GlassLight
from fingerflow.kernels.contact_sizes import FULL_LIGHT, LEAST_LIGHT, PIXELS_OF_LIGHT
from fingerflow.kernels.library import compiled, is_present

_NOWHERE = np.float32(-1e4)


def glass_light(empty: Array, dark: Array | None, inside: Array | None = None) -> GlassLight:
    """Compute the light of the empty glass and the black level (1, 1, H, W), as `ops.glass_light`, from counts (H, W).

    `dark` is the view without light. Where the mask `inside` (H, W) bool is False, the light is set to 0, so that no
    contact is found there.
    """
    empty = empty.astype(np.float32)
    black = np.zeros_like(empty) if dark is None else dark.astype(np.float32)
    light = empty - black
    step = max(1, min(light.shape) // PIXELS_OF_LIGHT)
    sample = np.sort(light[::step, ::step], axis=None)
    sample = sample[np.isfinite(sample)]
    full = sample[max(math.ceil(len(sample) * FULL_LIGHT), 1) - 1] if len(sample) else math.nan
    lit = np.isfinite(light) & (light > 0) & (light > LEAST_LIGHT * full)
    if inside is not None:
        lit &= inside
    light, black = np.where(lit, light, np.float32(0)), np.where(np.isfinite(black), black, np.float32(0))
    return light[None, None], black[None, None]


def covers(density_margin: Array, points: Array, topography_to_contact: Array, cell: int) -> Array:
    """Return a mask (K, N) bool of the points that the apparent contact covers.

    It is False outside the view and where a point is NaN. A point at the border, to rounding, may be covered with the
    compiled library and not without it.

    Args:
        density_margin: (K, 1, h, w) of `FrameContact`, on cells of `cell` px.
        points: (K, N, 2) px of the topography view.
        topography_to_contact: (2, 3), maps px of the topography view to px of the contact view.
        cell: px, side of a cell.
    """
    matrix = topography_to_contact.astype(np.float32)
    if is_present():
        contact = {"density_margin": density_margin, "side": cell}
        mask: Array = compiled("covered")(**contact, points=points, transform=matrix)
        return mask
    across, down = np.moveaxis(np.asarray(points, np.float32), -1, 0)
    with np.errstate(invalid="ignore", over="ignore"):  # positions may be infinite
        x, y = (row[0] * across + row[1] * down + row[2] for row in matrix)
    height, width = density_margin.shape[-2:]
    known = np.isfinite(x) & np.isfinite(y)
    column, row = (
        (np.where(known, place, _NOWHERE) - np.float32((cell - 1) / 2)) / np.float32(cell) for place in (x, y)
    )
    inside = (column >= -0.5) & (column < width - 0.5) & (row >= -0.5) & (row < height - 0.5)
    result: Array = (_at_places(density_margin, column, row) > 0) & inside
    return result


def _at_places(cells: Array, x: Array, y: Array) -> Array:
    """Interpolate values on cells (K, 1, h, w) bilinearly at positions x and y (K, N), in units of cells.

    Positions beyond the middle of the outermost cells are clamped to it.
    """
    height, width = cells.shape[-2:]
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    left, top = (np.clip(np.floor(at), 0, max(size - 2, 0)) for at, size in ((x, width), (y, height)))
    first = (top * width + left).astype(np.intp)
    # Index steps to the next cell, 0 if the grid has only one column or row.
    right, down = min(1, width - 1), width * min(1, height - 1)
    flat = cells.reshape(len(cells), -1)
    a, b, c, d = (np.take_along_axis(flat, first + step, 1) for step in (0, right, down, down + right))
    across, along = x - left, y - top
    result: Array = (a * (1 - across) + b * across) * (1 - along) + (c * (1 - across) + d * across) * along
    return result
