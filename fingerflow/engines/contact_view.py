"""Light of the empty glass, and points in the apparent contact, the same for every engine."""

import math

import numpy as np

from fingerflow.engines.engine import Array, GlassLight
from fingerflow.kernels.contact_sizes import FULL_LIGHT, LEAST_LIGHT, PIXELS_OF_LIGHT
from fingerflow.kernels.library import compiled, is_present


def glass_light(empty: Array, dark: Array | None) -> GlassLight:
    """Compute the light of the empty glass and the black level (1, 1, H, W), as `ops.glass_light`, from counts (H, W).

    `dark` is the view without light.
    """
    empty = empty.astype(np.float32)
    black = np.zeros_like(empty) if dark is None else dark.astype(np.float32)
    light = empty - black
    step = max(1, min(light.shape) // PIXELS_OF_LIGHT)
    sample = np.sort(light[::step, ::step], axis=None)
    sample = sample[np.isfinite(sample)]
    full = sample[max(math.ceil(len(sample) * FULL_LIGHT), 1) - 1] if len(sample) else math.nan
    light[~((light > max(LEAST_LIGHT * full, 0)) & (light < np.inf))] = 0  # NaN, too
    black[~np.isfinite(black)] = 0
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
        return compiled("covered")(**contact, points=points, transform=matrix)
    across, down = np.moveaxis(np.asarray(points, np.float32), -1, 0)
    with np.errstate(invalid="ignore", over="ignore"):  # positions may be infinite
        x, y = (row[0] * across + row[1] * down + row[2] for row in matrix)
    size = np.array(density_margin.shape[:-3:-1], np.float32)[:, None, None]  # width, height
    position = (np.stack((x, y)) - np.float32((cell - 1) / 2)) / np.float32(cell)
    inside = np.all((position >= -0.5) & (position < size - 0.5), axis=0)  # False where it is not finite
    # Interpolate bilinearly; beyond the middle of the outermost cells the nearest cell counts.
    position = np.clip(np.where(inside, position, np.float32(0)), 0, size - 1)
    first = np.minimum(np.floor(position), np.maximum(size - 2, 0))
    (left, top), (right, below) = first.astype(int), np.minimum(first + 1, size - 1).astype(int)
    cells, frame, (across, along) = density_margin[:, 0], np.arange(len(inside))[:, None], position - first
    upper, lower = (cells[frame, row, left] * (1 - across) + cells[frame, row, right] * across for row in (top, below))
    return (upper * (1 - along) + lower * along > 0) & inside
