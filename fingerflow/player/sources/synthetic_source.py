"""Synthetic source: frames of a pressed fingertip, drawn from formulas."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from fingerflow.engines.engine import Array
from fingerflow.player.stream_scene import find_topography
from fingerflow.schema.scene import Scene, scene_from

# Number of different sections of the noise, and step between those of two consecutive frames; both are primes.
_NOISES, _NOISE_STEP = 4099, 1009
# Width of the rim over which ridges begin to touch, inside and outside of the border. With a sharp border a whole ridge
# touches in one frame, which no press does: the frame then waits for those behind it, as if the image had jumped. With
# a wide one outside, the rim counts as faint.
_RIM_PX = 6.0, 4.0


def side_by_side(height: int, width: int) -> Scene:
    """Return the scene of the synthetic source, with two views of height x width px: topography on the left, contact on
    the right.
    """
    topography, contact = ({"rows": [0, height], "columns": [first, first + width]} for first in (0, width))
    settings = {
        "views": {"topography": topography, "contact": contact},
        "calibration": {"mm_per_px": 0.025, "topography_to_contact": [[1, 0, 0], [0, 1, 0]]},
        "contact": {"threshold": 0.35},
    }
    return scene_from(settings, Path("synthetic"), "synthetic source", "stream")


class Synthetic:
    """Endless source of synthetic frames of a pressed fingertip, drawn from formulas.

    Ridges and pores move, turn and spread by up to 4 % in each direction and back, while the contact grows and shrinks.
    The divergence in a stream differs from that and may be negative, because each point's displacement counts from its
    own onset. Only half a period is stored; it is played forwards and backwards, each frame with its own noise of one
    grey level of 8 bits, without which the way back would count as copies of frames.

    Attributes:
        background: (H, W), the glass without a finger.
    """

    live, stamp = False, math.nan
    half_period = 60  # frames

    def __init__(self, scene: Scene, dtype: np.dtype[Any], bit_depth: int) -> None:
        """Draw and store the frames of half a press period, from least to most contact, with the views of a scene."""
        self._next = 0
        topography, contact = views = find_topography(scene), scene.views.contact
        scale = scene.calibration.mm_per_px
        shape = tuple(max(ends) for ends in zip(*((view.rows[1], view.columns[1]) for view in views), strict=True))
        self._ring = np.zeros((self.half_period, *shape), dtype)
        gain = 2.0 ** (bit_depth - 8)
        noise = np.random.default_rng(0).normal(0, gain, math.prod(shape) + _NOISES)
        # Negative values wrap around, as the sum does.
        self._noise = np.round(noise).clip(-4 * gain, 4 * gain).astype(np.int64).astype(dtype)
        self._expected: list[dict[str, float]] = []
        for number, frame in enumerate(self._ring):
            progress = (1 - math.cos(math.pi * number / (self.half_period - 1))) / 2
            skin, _ = _draw_finger(topography.shape, progress)
            topography.crop(frame)[...] = (90 + 70 * skin) * gain
            _, lost = _draw_finger(contact.shape, progress)
            contact.crop(frame)[...] = 200 * (1 - 0.7 * lost) * gain
            self._expected.append(expected(progress, contact.shape, scale, int((lost > 0.5).sum())))
        self.background = np.full(shape, 200 * gain, dtype)

    def frames_from(self, number: int) -> Synthetic:
        """Let `read` go on with frame `number`, and return the source itself."""
        self._next = number
        return self

    def read(self) -> Array:
        """Return the next frame (H, W)."""
        drawn = self._ring[self._buffer_index(self._next)]
        begin = self._next * _NOISE_STEP % _NOISES
        frame = drawn + self._noise[begin : begin + drawn.size].reshape(drawn.shape)
        self._next += 1
        return frame

    def expected_values(self, number: int) -> dict[str, float]:
        """Return the true contact areas in mm² and ellipse semi-axes in mm in frame `number`, by name."""
        return self._expected[self._buffer_index(number)]

    def _buffer_index(self, number: int) -> int:
        """Return the index among the stored frames of half a period at which frame `number` is found, as they are
        played forwards and backwards in turn.
        """
        index = number % (2 * self.half_period - 2)
        return min(index, 2 * self.half_period - 2 - index)

    def close(self) -> None:
        """Do nothing, as no file is open."""


def expected(progress: float, shape: tuple[int, int], mm_per_px: float, touching_px: int) -> dict[str, float]:
    """Return the true contact areas in mm² and ellipse semi-axes in mm, by name, at a progress 0 to 1 of the press in
    views of (height, width) px.

    The border of the visible contact, which has lost half of the light that contact can take, is that of the ellipse.

    Args:
        touching_px: number of pixels that have lost more than half of the light that contact can take.
    """
    minor, major = sorted(mm_per_px * semi_axis for semi_axis in _semi_axes(progress, shape))
    areas = {"real_contact_area": touching_px * mm_per_px**2, "gross_contact_area": math.pi * major * minor}
    return areas | {"ellipse_major": major, "ellipse_minor": minor}


def _semi_axes(progress: float, shape: tuple[int, int]) -> tuple[float, float]:
    """Return the semi-axes (x, y) px of the simulated contact in a view of (height, width) px."""
    return (0.18 + 0.14 * progress) * shape[1], (0.18 + 0.18 * progress) * shape[0]


def _draw_finger(shape: tuple[int, int], progress: float) -> tuple[Array, Array]:
    """Draw a finger in a view of (height, width) px at a progress 0 to 1 of the press; return the brightness of its
    skin, about -1 to 1, and the share of light lost to contact.

    Both are (H, W) float32.
    """
    height, width = shape
    shift_x, shift_y, turn, spread = 4 * progress, -2 * progress, 0.01 * progress, 1 + 0.04 * progress
    rows, columns = np.ogrid[:height, :width]
    y, x = (rows - height / 2).astype(np.float32), (columns - width / 2).astype(np.float32)
    moved_x, moved_y = x - shift_x, y - shift_y
    # Position at the start of the skin that is visible at a pixel.
    u = (math.cos(turn) * moved_x + math.sin(turn) * moved_y) / spread
    v = (-math.sin(turn) * moved_x + math.cos(turn) * moved_y) / spread
    ridges = np.cos(2 * np.pi / 16 * (np.hypot(u, v + 60) + 6 * np.cos(u / 45)))
    pores = np.cos(0.31 * u + 0.17 * v) * np.cos(0.13 * u - 0.37 * v) + np.cos(0.21 * u - 0.11 * v + 1) / 2
    semi_x, semi_y = _semi_axes(progress, shape)
    depth = (1 - np.hypot(moved_x / semi_x, moved_y / semi_y)) * min(semi_x, semi_y)
    inside = np.clip(0.5 + 0.5 * depth / np.where(depth > 0, *_RIM_PX), 0, 1)
    return 0.55 * ridges + 0.3 * pores, np.clip(0.5 + 4 * (ridges + 0.2), 0, 1) * inside
