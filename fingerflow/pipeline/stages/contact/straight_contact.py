"""Areas and ellipses of the contact as a lens without distortion and square pixels would show them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fingerflow.engines.engine import FrameContact
from fingerflow.recordings.lens import Lens
from fingerflow.schema.views import View

Array = NDArray[np.float64]


class StraightSizes(NamedTuple):
    """Sizes of the contact in n frames.

    Attributes:
        area_gain: (n,), or 1: area over the number of recorded pixels.
        center, semi_axes, angle: of the fitted ellipse, px and rad.
    """

    area_gain: Array | float
    center: Array
    semi_axes: Array
    angle: Array


class StraightContact:
    """Correction of contact sizes for a lens, by means over the cells of the gross contact: of the gain of areas, the
    shift of the centre of area, and the derivative (Jacobian) of straight positions, which maps the ellipse.

    Contact without a gross region takes the means over the view.
    """

    def __init__(self, lens: Lens | None, view: View, cell_px: int) -> None:
        self._means: Array | None = None
        if lens is not None:
            y, x = (np.arange(-(-side // cell_px)) * cell_px + (cell_px - 1) / 2 for side in view.shape)
            recorded = np.stack(np.meshgrid(x, y), -1)
            straight = lens.straighten(recorded, view)
            down, right = map(np.asarray, np.gradient(straight, cell_px, axis=(0, 1), edge_order=2))
            gain = right[..., :1] * down[..., 1:] - right[..., 1:] * down[..., :1]
            self._means = np.concatenate((gain, gain * straight, recorded, right, down), -1).reshape(-1, 9)

    def sizes(self, contact: FrameContact) -> StraightSizes:
        """Return the corrected sizes in a batch of frames."""
        center, axes = (values.astype(np.float64) for values in (contact.center, contact.semi_axes))
        if self._means is None:
            return StraightSizes(1.0, center, axes, contact.angle)
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
        reach = np.hypot((xx - yy) / 2, xy)
        squares = (xx + yy)[:, None] / 2 + reach[:, None] * (1, -1)
        return StraightSizes(
            means[:, 0], center + shift, np.sqrt(np.maximum(squares, 0)), np.arctan2(2 * xy, xx - yy) / 2
        )
