"""Lens of a camera: pixels of the frame, and those that a lens without distortion and square pixels would give."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.schema.scene_tables import CalibrationSettings
from fingerflow.schema.views import Rectangle

Array = NDArray[np.float64]
_ITERATIONS, _TOLERANCE = 100, 1e-12  # of the inverse of the model, focal lengths
_LARGEST_ERROR_PX = 1e-3
_GRID = 9  # positions along each side of a view that are checked


@dataclass(frozen=True)
class Lens:
    """Lens with radial and tangential distortion, by OpenCV's model, and pixels that need not be square.

    Positions (..., 2) are (x, y) in px of a view. Straight positions have pixels as wide and as high as those at the
    principal point are wide; the centre of the view keeps its position.

    Attributes:
        intrinsics: fx, fy, cx, cy: focal lengths and principal point, px of the camera frame.
        distortion: k1, k2, p1, p2, k3.
    """

    intrinsics: tuple[float, float, float, float]
    distortion: tuple[float, float, float, float, float]

    @classmethod
    def of(cls, calibration: CalibrationSettings) -> "Lens | None":
        """Return the lens of a calibration; None if it states none."""
        if calibration.intrinsics is None:
            return None
        return cls(calibration.intrinsics, calibration.distortion or (0.0, 0.0, 0.0, 0.0, 0.0))

    def straighten(self, pixels: Array, view: Rectangle) -> Array:
        """Return the straight positions of recorded ones; the inverse of `distort`."""
        centre = _centre(view)
        return (self._rays(pixels, view) - self._rays(centre, view)) * self.intrinsics[0] + centre

    def distort(self, pixels: Array, view: Rectangle) -> Array:
        """Return the recorded positions of straight ones."""
        centre = _centre(view)
        fx, fy, cx, cy = self.intrinsics
        rays = (pixels - centre) / fx + self._rays(centre, view)
        return self._distorted(rays) * (fx, fy) + (cx, cy) - _corner(view)

    def check(self, view: Rectangle) -> None:
        """Raise FingerflowError unless each position in a view has a straight one, as in the view of a real lens."""
        rows, columns = view.shape
        pixels = np.stack(np.meshgrid(np.linspace(0, columns, _GRID), np.linspace(0, rows, _GRID)), -1) - 0.5
        straight = self.straighten(pixels, view)
        error = np.abs(self.distort(straight, view) - pixels).max()
        down, right = np.diff(straight, axis=0)[:, :-1], np.diff(straight, axis=1)[:-1]
        turned = (right[..., 0] * down[..., 1] <= right[..., 1] * down[..., 0]).any()
        if turned or not error < _LARGEST_ERROR_PX:
            raise FingerflowError(
                f"calibration.intrinsics = {list(self.intrinsics)} and distortion = {list(self.distortion)} fold the "
                f"view with rows {list(view.rows)}, columns {list(view.columns)} onto itself, as no lens does: check "
                f"that both are of this camera, in px of its whole frame, and the order k1, k2, p1, p2, k3"
            )

    def _rays(self, pixels: Array, view: Rectangle) -> Array:
        """Return the slopes of the rays through recorded positions: a fixed point of `rays + recorded - distorted`."""
        fx, fy, cx, cy = self.intrinsics
        recorded = (pixels + _corner(view) - (cx, cy)) / (fx, fy)
        rays = recorded
        with np.errstate(over="ignore", invalid="ignore"):  # `check` refuses a lens for which there is no fixed point
            for _ in range(_ITERATIONS):
                error = recorded - self._distorted(rays)
                rays = rays + error
                if not (np.abs(error) > _TOLERANCE).any():
                    break
        return rays

    def _distorted(self, rays: Array) -> Array:
        k1, k2, p1, p2, k3 = self.distortion
        x, y = rays[..., 0], rays[..., 1]
        square = x * x + y * y
        radial = 1 + square * (k1 + square * (k2 + square * k3))
        return np.stack(
            (
                x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
                y * radial + 2 * p2 * x * y + p1 * (square + 2 * y * y),
            ),
            -1,
        )


def _corner(view: Rectangle) -> Array:
    return np.array([view.columns[0], view.rows[0]], dtype=np.float64)


def _centre(view: Rectangle) -> Array:
    return (np.array(view.shape[::-1]) - 1) / 2
