"""Parts of which the motion of skin is composed: the elliptic edge of a contact, and local displacements.

Positions are in mm on the glass, x right, y down.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor


@dataclass(frozen=True)
class Ellipse:
    """Elliptic edge of a region: centre (mm), semi-axes (mm), and angle (rad) from x to the first axis, towards y."""

    centre: tuple[float, float]
    semi_axes: tuple[float, float]
    angle: float = 0.0

    @property
    def area(self) -> float:
        """Return the enclosed area in mm²."""
        return math.pi * self.semi_axes[0] * self.semi_axes[1]

    @property
    def reach(self) -> tuple[float, float]:
        """Return the half width and half height (mm) of the ellipse's bounding box."""
        (first, second), cosine, sine = self.semi_axes, math.cos(self.angle), math.sin(self.angle)
        return math.hypot(first * cosine, second * sine), math.hypot(first * sine, second * cosine)

    def edge(self, count: int) -> NDArray[np.float64]:
        """Return `count` points (count, 2), mm, around the ellipse, at even steps of its parametric angle."""
        turn = np.exp(2j * np.pi * np.arange(count) / count)
        around = np.exp(1j * self.angle) * (self.semi_axes[0] * turn.real + 1j * self.semi_axes[1] * turn.imag)
        return np.stack((around.real, around.imag), -1) + self.centre

    def radius(self, x: Tensor, y: Tensor) -> Tensor:
        """Return the distance of positions (x, y), mm, from the centre relative to that of the ellipse in the same
        direction: 0 at the centre, 1 on the ellipse.
        """
        return _length(*self._principal(x, y))

    def distance(self, x: Tensor, y: Tensor) -> Tensor:
        """Return the distance, mm, of positions (x, y) from the ellipse, positive inside: exact on the ellipse and
        first order near it.
        """
        along, across = self._principal(x, y)
        radius = _length(along, across)
        return (1 - radius) * radius / _length(along / self.semi_axes[0], across / self.semi_axes[1])

    def _principal(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Return the coordinates of positions (x, y), mm, along the two axes of the ellipse, from its centre and in
        units of the semi-axes.
        """
        cosine, sine = math.cos(self.angle), math.sin(self.angle)
        (first, second), (centre_x, centre_y) = self.semi_axes, self.centre
        right, down = x - centre_x, y - centre_y
        return (
            (cosine / first * right).add(down, alpha=sine / first),
            (-sine / second * right).add(down, alpha=cosine / second),
        )


def _length(first: Tensor, second: Tensor) -> Tensor:
    # 1e-30 is below the rounding of any relevant position, and makes the gradient at the centre 0 instead of NaN.
    return torch.sqrt(first.square() + second.square() + 1e-30)


@dataclass(frozen=True)
class Bump:
    """Displacement field that fades as a Gaussian: (shift + dilation x (position - centre)) exp(-distance² / 2 width²).

    centre, width and shift are in mm; the dilation (mm per mm) adds twice itself to the divergence at the centre.
    """

    centre: tuple[float, float]
    width: float
    shift: tuple[float, float] = (0.0, 0.0)
    dilation: float = 0.0

    def __call__(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        right, down = x - self.centre[0], y - self.centre[1]
        weight = torch.exp((right.square() + down.square()) * (-0.5 / self.width**2))
        return weight * (self.shift[0] + self.dilation * right), weight * (self.shift[1] + self.dilation * down)
