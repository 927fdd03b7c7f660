"""Conversion of areas and ellipses of the contact from px of the contact view to mm on the glass."""

from typing import NamedTuple

import numpy as np

from fingerflow.engines.engine import FrameContact, FrameEllipse
from fingerflow.kernels.array_types import Array
from fingerflow.recordings.lens import Geometry


class Sizes(NamedTuple):
    """Sizes of the contact in n frames.

    Attributes:
        pixel: (n,) or () mm^2, area of a recorded pixel.
        real, gross: (n,) mm^2, areas.
        ellipse: mm and rad, fitted to the apparent (gross) contact.
    """

    pixel: Array
    real: Array
    gross: Array
    ellipse: FrameEllipse

    def by_name(self) -> dict[str, Array]:
        """Return the results by name."""
        ellipse = {f"ellipse_{name}": values for name, values in self.ellipse._asdict().items()}
        return {"real_contact_area": self.real, "gross_contact_area": self.gross, **ellipse}


class SizesOnGlass:
    """Conversion of contact sizes to mm, corrected for a lens by means over the cells of the gross contact: of the gain
    of areas, the shift of the centre of area, and the derivative (Jacobian) of straight positions, which maps the
    ellipse.

    Contact without a gross region takes the means over the view.
    """

    def __init__(self, geometry: Geometry, cell_px: int) -> None:
        self._size, lens, view = geometry.mm_per_px, geometry.lens, geometry.contact
        self._means: Array | None = None
        if lens is not None and view is not None:
            y, x = (np.arange(-(-side // cell_px)) * cell_px + (cell_px - 1) / 2 for side in view.shape)
            recorded = np.stack(np.meshgrid(x, y), -1)
            straight = lens.straighten(recorded, view)
            down, right = map(np.asarray, np.gradient(straight, cell_px, axis=(0, 1), edge_order=2))
            gain = right[..., :1] * down[..., 1:] - right[..., 1:] * down[..., :1]
            self._means = np.concatenate((gain, gain * straight, recorded, right, down), -1).reshape(-1, 9)

    def sizes(self, contact: FrameContact) -> Sizes:
        """Convert the sizes of the contact in n frames."""
        center, axes = contact.center.astype(np.float64), contact.semi_axes.astype(np.float64)
        angle, pixel = contact.angle, np.asarray(self._size**2)
        if self._means is not None:
            gain, center, axes, angle = self._straightened(contact, center, axes)
            pixel = gain * pixel
        real, gross = contact.real_area_px.astype(np.float64), contact.gross_area_px.astype(np.float64)
        ellipse = FrameEllipse(center * self._size, axes * self._size, angle.astype(np.float64))
        return Sizes(pixel, real * pixel, gross * pixel, ellipse)

    def _straightened(self, contact: FrameContact, center: Array, axes: Array) -> tuple[Array, Array, Array, Array]:
        """Return gain of the area (n,), centre (n, 2) px, semi-axes (n, 2) px and angle (n,) without the distortion of
        the lens.
        """
        inside = contact.density_margin.reshape(len(center), -1) > 0
        inside |= ~inside.any(1, keepdims=True)
        means = inside @ self._means / inside.sum(1, keepdims=True)
        shift = means[:, 1:3] / means[:, :1] - means[:, 3:5]
        jacobian = means[:, 5:].reshape(-1, 2, 2).swapaxes(1, 2)
        cosine, sine = np.cos(contact.angle), np.sin(contact.angle)
        turn = np.stack((cosine, -sine, sine, cosine), -1)
        half = jacobian @ turn.reshape(-1, 2, 2) * axes[:, None]
        moments = half @ half.swapaxes(1, 2)
        xx, xy, yy = moments[:, 0, 0], moments[:, 0, 1], moments[:, 1, 1]
        squares = (xx + yy)[:, None] / 2 + np.hypot((xx - yy) / 2, xy)[:, None] * (1, -1)
        return means[:, 0], center + shift, np.sqrt(np.maximum(squares, 0)), np.arctan2(2 * xy, xx - yy) / 2
