"""Synthetic presses whose contact stops growing, or shrinks, while the skin in it goes on moving."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from fingerflow.synthetic import Press
from fingerflow.synthetic.motion import Ellipse

_ONE = Tensor([1.0]).double()[0]


@dataclass(frozen=True, kw_only=True)
class CourseOfPress(Press):
    """Press at a constant rate of its progress from the trigger on, whose contact grows up to the progress `grown`, and
    shrinks by the share `released` of its length from the progress `lifts` on, while the skin moves up to `held`.

    With m = min(progress / held, 1)^2: material = position - m^2 (gradient (position - centre) + shift + bumps) - d,
    where d is the vector `dragged` times the share of the time between `grown` and `held` that has passed.
    """

    grown: float = 0.6
    held: float = 0.85
    lifts: float = 1.0
    released: float = 0.0
    dragged: tuple[float, float] = (0.0, 0.0)

    entry_steps = 64  # skin may leave the contact, and skin that is dragged may enter it

    def material(self, x: Tensor, y: Tensor, progress: Tensor) -> tuple[Tensor, Tensor]:
        x_still, y_still = super().material(x, y, (progress / self.held).clamp(max=1.0))
        share = ((progress - self.grown) / (self.held - self.grown)).clamp(0.0, 1.0)
        return x_still - share * self.dragged[0], y_still - share * self.dragged[1]

    def depth(self, x: Tensor, y: Tensor, progress: Tensor) -> Tensor:
        return self._size(progress) - self.contact.radius(x, y)

    def ellipse(self, progress: float) -> Ellipse | None:
        size = float(self._size(progress * _ONE))
        if size <= 0:
            return None
        first, second = self.contact.semi_axes
        return Ellipse(self.contact.centre, (size * first, size * second), self.contact.angle)

    def _size(self, progress: Tensor) -> Tensor:
        lifted = ((progress - self.lifts) / max(1 - self.lifts, 1e-9)).clamp(min=0.0)
        return (progress / self.grown).clamp(max=1.0) * (1 - self.released * lifted)

    def progress(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        return self._share_of_rise(time)
