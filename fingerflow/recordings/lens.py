"""Conversion between px of the views and mm on the glass, corrected for the lens of the camera."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.schema.scene_tables import CalibrationSettings
from fingerflow.schema.views import Rectangle

Array = NDArray[np.float64]
_ITERATIONS, _TOLERANCE = 100, 1e-12  # of the inverse of the model, focal lengths
_LARGEST_ERROR_PX = 1e-3
_CHECKED, _GRID = 9, 17  # positions along each side of a view that are checked, and at which maps are averaged


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
        pixels = np.stack(np.meshgrid(np.linspace(0, columns, _CHECKED), np.linspace(0, rows, _CHECKED)), -1) - 0.5
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
        right = x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)
        down = y * radial + 2 * p2 * x * y + p1 * (square + 2 * y * y)
        return np.stack((right, down), -1)


@dataclass(frozen=True)
class Geometry:
    """Conversion between px of the views and mm on the glass, corrected for the lens if the calibration states it.

    Raises FingerflowError for a lens that folds a view.

    Attributes:
        calibration: scale of the contact view, map from the topography view to it, and lens.
        contact, topography: the views; None for a scene without it.
    """

    calibration: CalibrationSettings
    contact: Rectangle | None
    topography: Rectangle | None

    def __post_init__(self) -> None:
        for view in (self.contact, self.topography):
            if self.lens is not None and view is not None:
                self.lens.check(view)

    @property
    def mm_per_px(self) -> float:
        return self.calibration.mm_per_px

    @cached_property
    def lens(self) -> Lens | None:
        """Return the lens by whose distortion positions and areas are corrected; None if none is stated."""
        stated = self.calibration
        if stated.intrinsics is None:
            return None
        return Lens(stated.intrinsics, stated.distortion or (0.0, 0.0, 0.0, 0.0, 0.0))

    @cached_property
    def _transform(self) -> Array:
        return np.array(self.calibration.topography_to_contact, dtype=np.float64)

    @cached_property
    def topography_to_contact(self) -> Array:
        """Return the affine map (2, 3) from recorded px of the topography view to recorded px of the contact view; with
        a lens, the map that is closest over the view.
        """
        if self.lens is None:
            return self._transform
        assert self.contact is not None, "the scene has both views where it has the map"
        pixels = self._over_topography()
        return _affine(pixels, self.lens.distort(self.on_glass(pixels) / self.mm_per_px, self.contact))

    @property
    def magnification(self) -> float:
        """Return the number of recorded px of the contact view along the side of one of the topography view."""
        return float(np.sqrt(abs(np.linalg.det(self.topography_to_contact[:, :2]))))

    def on_glass(self, pixels: NDArray[Any]) -> Array:
        """Convert positions (..., 2) from px of the topography view to mm on the glass."""
        pixels = pixels.astype(np.float64)
        if self.lens is not None:
            pixels = self.lens.straighten(pixels, self._topography)
        result = np.empty(pixels.shape)
        # Each component separately: a product with so small a matrix takes several times as long.
        for axis, (by_x, by_y, shift) in enumerate((self._transform * self.mm_per_px).tolist()):
            result[..., axis] = by_x * pixels[..., 0] + by_y * pixels[..., 1] + shift
        return result

    def on_topography(self, positions: Array) -> Array:
        """Convert positions (..., 2) from mm on the glass to px of the topography view."""
        matrix = self._transform
        pixels = (positions / self.mm_per_px - matrix[:, 2]) @ np.linalg.inv(matrix[:, :2]).T
        return pixels if self.lens is None else self.lens.distort(pixels, self._topography)

    @cached_property
    def topography_mm_per_px(self) -> float:
        """Return the scale of the topography view, mm per px: the root of the area of a pixel, with a lens its mean."""
        matrix = self._transform * self.mm_per_px
        if self.lens is not None:
            pixels = self._over_topography()
            matrix = _affine(pixels, self.on_glass(pixels))
        return float(np.sqrt(abs(np.linalg.det(matrix[:, :2]))))

    @property
    def _topography(self) -> Rectangle:
        assert self.topography is not None, "points are tracked in it"
        return self.topography

    def _over_topography(self) -> Array:
        """Return positions (n, 2) px all over the topography view."""
        y, x = np.meshgrid(*(np.linspace(0, side - 1, _GRID) for side in self._topography.shape))
        return np.column_stack((x.ravel(), y.ravel()))


def _affine(pixels: Array, values: Array) -> Array:
    """Return the affine map (2, 3) that maps positions (n, 2) closest to `values`, by least squares."""
    return np.asarray(np.linalg.lstsq(np.insert(pixels, 2, 1, axis=1), values, rcond=None)[0].T, np.float64)


def _corner(view: Rectangle) -> Array:
    return np.array([view.columns[0], view.rows[0]], dtype=np.float64)


def _centre(view: Rectangle) -> Array:
    return (np.array(view.shape[::-1]) - 1) / 2
