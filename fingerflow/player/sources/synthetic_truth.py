"""True results for the synthetic finger, from formulas: areas, axes of the contact ellipse and divergence."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fingerflow.engines.engine import Array

# Least number of skin positions and of queried positions; twice as many change the median by less than 2e-3.
_SKIN, _QUERIES = 500, 200
_IN_A_FIT, _MOST_SKIN = 20, 2000  # least number of skin positions in a local fit, and largest number overall
_HALVINGS = 30


class Pose(NamedTuple):
    """Shift, rotation and uniform stretch of the skin, and contact ellipse, in px, at a progress 0 to 1 of the press.

    Values are arrays if the progress is an array. Skin that lies at u from the middle of the view at progress 0 lies at
    ``shift + spread R(turn) u``. The contact is an ellipse about ``shift`` with the semi-axes ``semi`` along x and y.
    """

    shift: tuple[Array | float, Array | float]
    turn: Array | float
    spread: Array | float
    semi: tuple[Array | float, Array | float]

    @classmethod
    def reached(cls, progress: Array | float, shape: tuple[int, int]) -> Pose:
        """Return the pose at a given progress of the press, in views of (height, width) px."""
        height, width = shape
        return cls(
            shift=(4 * progress, -2 * progress),
            turn=0.01 * progress,
            spread=1 + 0.04 * progress,
            semi=((0.18 + 0.14 * progress) * width, (0.18 + 0.18 * progress) * height),
        )

    def deformation(self) -> Array:
        """Return the deformation gradient (..., 2, 2) of the skin since the start of the press (progress 0)."""
        c, s = np.cos(self.turn), np.sin(self.turn)
        turned: Array = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
        turned *= np.asarray(self.spread)[..., None, None]
        return turned

    def positions(self, skin: Array) -> Array:
        """Return the present positions of skin points (..., 2) in px, relative to the middle of the view.

        `skin` are their positions at progress 0.
        """
        moved = np.einsum("...ij,...j->...i", self.deformation(), skin)
        moved += np.stack(np.broadcast_arrays(*self.shift), -1)
        return np.asarray(moved)

    def seen_axes(self) -> tuple[Array | float, Array | float]:
        """Return the semi-axes of the visible contact, px: `semi` scaled so that the shorter one is half a pixel less.

        At that border the contact has lost half of its light.
        """
        share = 1 - 0.5 / np.minimum(*self.semi)
        return self.semi[0] * share, self.semi[1] * share

    def reach(self, skin: Array) -> Array:
        """Return the distance of skin points (..., 2), given at progress 0, from the centre of the contact ellipse,
        relative to the ellipse's border in that direction: below 1 in contact.
        """
        moved = np.einsum("...ij,...j->...i", self.deformation(), skin)
        a, b = self.seen_axes()
        return np.asarray(np.hypot(moved[..., 0] / a, moved[..., 1] / b))


def expected(progress: float, shape: tuple[int, int], mm_per_px: float, touching_px: int) -> dict[str, float]:
    """Return the true contact areas in mm² and ellipse semi-axes in mm, by name, at a progress 0 to 1 of the press in
    views of (height, width) px.

    Args:
        touching_px: number of pixels that have lost more than half of the light that contact can take.
    """
    axes = sorted(
        (float(semi_axis) * mm_per_px for semi_axis in Pose.reached(progress, shape).seen_axes()), reverse=True
    )
    return {
        "real_contact_area": touching_px * mm_per_px**2,
        "gross_contact_area": math.pi * axes[0] * axes[1],
        "ellipse_major": axes[0],
        "ellipse_minor": axes[1],
    }


def median_divergence(progress: float, reached: float, shape: tuple[int, int], gauge_px: float) -> float:
    """Return the true median over the contact of the divergence of skin displacement, where the displacement of each
    point counts from the moment at which the growing contact reached it.

    Points are seeded at progress 0. Skin u is touched at the progress p0(u) at which the growing contact reaches it:
    its displacement is x(u, p) - x(u, p0(u)). Here it is known without error and for all skin. The gradient G is fitted
    to it as in a stream (`ops.fields.area_medians`): planes over the gauge length with weights (1 - (r/R)²)², and G (1
    - G)^-1 in reference coordinates. A measurement differs from this value only by the errors of the points and their
    limited number.

    Args:
        progress: of the frame.
        reached: largest progress until then; the skin that was in contact then is known.
        gauge_px: gauge length. The result is NaN if it is so short relative to the contact that too many positions
            would be needed.
    """
    now, widest = Pose.reached(progress, shape), Pose.reached(reached, shape)
    a, b = widest.seen_axes()
    count = max(_SKIN, math.ceil(_IN_A_FIT * float(a * b) / (gauge_px / 2) ** 2))
    if count > max(_SKIN, _MOST_SKIN):
        return math.nan
    skin = (_lattice(count) * np.array([a, b])) @ np.linalg.inv(widest.deformation()).T
    low, high = np.zeros(len(skin)), np.full(len(skin), reached)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        touched = Pose.reached(middle, shape).reach(skin) < 1
        low, high = np.where(touched, low, middle), np.where(touched, middle, high)
    positions = now.positions(skin)
    moved = positions - Pose.reached(high, shape).positions(skin)

    queries = _lattice(_QUERIES) * np.array(now.seen_axes()) + np.array(now.shift)
    away = (positions[None] - queries[:, None]) / (gauge_px / 2)
    weights = np.clip(1 - (away**2).sum(-1), 0, None) ** 2
    design = np.concatenate([np.ones((*away.shape[:2], 1)), away], -1)
    weighted = design * weights[..., None]
    slopes = np.linalg.solve(weighted.swapaxes(1, 2) @ design, weighted.swapaxes(1, 2) @ moved)[:, 1:]
    gradient = slopes.swapaxes(1, 2) / (gauge_px / 2)
    divergence = np.einsum("nij,nji->n", gradient, np.linalg.inv(np.eye(2) - gradient))
    return float(np.median(divergence))


def _lattice(count: int) -> Array:
    """Return points (count, 2) spread evenly over the unit disc (Vogel 1979)."""
    number = np.arange(count) + 0.5
    radius, turn = np.sqrt(number / count), number * (math.pi * (3 - 5**0.5))
    return np.stack([radius * np.cos(turn), radius * np.sin(turn)], -1)
