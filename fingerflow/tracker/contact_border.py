"""Border of the apparent contact, approximated by an ellipse."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

# Standard deviation, mm, of the position of the contact's border, which runs between ridges that lie 0.4 to 0.5 mm
# apart. It was measured on the shipped press, whose border is known.
BORDER_MM = 0.06


class Border(NamedTuple):
    """Border ellipses of the apparent (gross) contact, one a frame; NaN in frames without contact."""

    center: Array  # (frames, 2) mm, centre of the ellipse
    semi_axes: Array  # (frames, 2) mm, semi-axes
    angle: Array  # (frames,) rad, angle of the first semi-axis from x towards y

    @classmethod
    def from_series(cls, series: Mapping[str, NDArray[np.float64]]) -> Self:
        """Create the border ellipses from results named `ellipse_center`, `ellipse_semi_axes` and `ellipse_angle`."""
        return cls(*(series[f"ellipse_{name}"] for name in cls._fields))

    def select(self, frames: slice | NDArray[np.intp]) -> Border:
        """Return the border ellipses of the given frames, a slice or indices."""
        return Border(self.center[frames], self.semi_axes[frames], self.angle[frames])

    def inside(self, positions: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the distance (frames, P), mm, of positions (frames, P, 2) from the border ellipse of their frame,
        positive inside the ellipse and negative outside.

        It is accurate to first order, and exact on the border.
        """
        # Compute each component separately: NumPy takes several times as long for sums over an axis of two.
        (center_x, center_y), (first, second) = self.center.T[..., None], self.semi_axes.T[..., None]
        cosine, sine = np.cos(self.angle)[:, None], np.sin(self.angle)[:, None]
        right, down = positions[..., 0] - center_x, positions[..., 1] - center_y
        along, across = (right * cosine + down * sine) / first, (down * cosine - right * sine) / second
        radius = np.sqrt(along * along + across * across)
        along, across = along / first, across / second
        slope = np.sqrt(along * along + across * across)
        return (1 - radius) * radius / np.maximum(slope, 1e-12)
