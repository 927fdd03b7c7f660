"""Synthetic trial of tangential loading: force T rises at constant normal force N until the whole contact slips."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy.optimize import brentq
from torch import Tensor

from fingerflow.models.partial_slip import critical_load_ratio, critical_stuck_area, stuck_area
from fingerflow.synthetic.scenes import Array
from fingerflow.synthetic.slide import Slide

_STEEPEST = 1.5  # largest slope of `_smoothstep`
_MOST_STRETCH = 0.5  # largest stretch that jumps may add to the skin
_ROUNDED = 0.1  # relative radius over which the stretch builds up beside the stick region


@dataclass(frozen=True, kw_only=True)
class PartialSlip(Slide):
    """Synthetic slide under a linearly rising load ratio T/N, whose stick region at each load is that of the
    partial-slip model (Terekhov & Hayward 2011).

    d² follows equation 5 of Terekhov & Hayward (2011) up to the critical load. If kinetic friction is the smaller one,
    the critical area then collapses at constant load, linearly in time; otherwise it has faded to nothing. From then on
    contact and skin travel together, and T/N falls to mu_k within `collapse`. The truth of a frame is `stuck_share`,
    d²; `slow_share`, the estimate of d² by a displacement limit; and `truth`, the position of each point.

    With r the relative radius in the contact and s that of the stuck ellipse, skin outside it has moved by creep (f(r -
    s) - f(r - 1)), f(x) = sqrt(x² + 0.1²) - 0.1 for x > 0 and 0 below. From the border of the stick region the skin
    takes up a uniform stretch, and beyond the contact it moves rigidly. Nothing has moved where s = 1. Each jump before
    full slip adds `jump` g((r - s) / (1 - s)), g rising from 0 to 1 as 3 x² - 2 x³.

    Settings are those of `Slide`. Here `creep` is the displacement of the skin at the rim of the contact when nothing
    sticks any more: about its stretch along the pull (0.2 by default) times a semi-axis.

    Args:
        collapse: s from the critical area to none.
        jumps: s at which skin jumps along the pull from one frame to the next, as in stick-slip. Before full slip only
            slipping skin jumps: by 0 at the border of the stick region, rising to `jump` at the rim and beyond. After
            it contact and skin jump together.
        jump: mm of one jump; 5 px of the contact view are 0.1625 mm.

    Raises:
        ValueError: a jump before the pull begins, or while the slipping annulus is too narrow for the stretch.
    """

    n_frames: int = 300
    frame_rate: float = 60.0
    static_friction: float = 0.8
    kinetic_friction: float = 0.4
    creep: float = 1.0
    travel: float = 3.0
    full_slip: float = 0.75
    collapse: float = 0.2
    jumps: tuple[float, ...] = ()
    jump: float = 0.1625

    def __post_init__(self) -> None:
        for number, time in enumerate(sorted(self.jumps), 1):
            stuck = float(self.stuck_radius(torch.tensor(time / self.times[-1], dtype=torch.float64)))
            annulus = (1 - stuck) * min(self.semi_axes)
            before = time < self.full_slip * self.times[-1]
            if time <= 0 or (before and _STEEPEST * number * self.jump > _MOST_STRETCH * annulus):
                raise ValueError(
                    f"jumps has {time} s: {annulus:.2f} mm of the contact slip then, and would be stretched by "
                    f"{_STEEPEST * number * self.jump / max(annulus, 1e-9):.0%}, at most {_MOST_STRETCH:.0%} are "
                    f"possible; make it later"
                )

    @cached_property
    def loaded(self) -> float:
        """Return the progress at which the critical load is reached."""
        critical = float(critical_stuck_area(self.static_friction, self.kinetic_friction).nan_to_num(0.0))
        return self.full_slip - (self.collapse / self.times[-1] if critical > 0 else 0.0)

    @cached_property
    def _jumps(self) -> list[float]:
        """Return the progress of each jump."""
        return [float(time / self.times[-1]) for time in self.jumps]

    def travelled(self, progress: Tensor) -> Tensor:
        """Return the distance, mm, by which contact and skin have slid together as a whole at a progress of the slide,
        including stick-slip jumps after full slip.
        """
        late = (at for at in self._jumps if at >= self.full_slip)
        return sum((self.jump * (progress >= at).to(progress.dtype) for at in late), super().travelled(progress))

    def jumped(self, progress: Tensor) -> Tensor:
        """Return the total length, mm, of the stick-slip jumps that the rim of the contact has made up to a progress of
        the slide, without those after full slip.
        """
        early = (at for at in self._jumps if at < self.full_slip)
        return self.jump * sum(((progress >= at).to(progress.dtype) for at in early), 0 * progress)

    def load_ratio(self, progress: Tensor) -> Tensor:
        """Return the load ratio T/N (tangential over normal force) at a progress of the slide, float64, while part of
        the contact sticks.
        """
        critical = critical_load_ratio(self.static_friction, self.kinetic_friction)
        return critical * (progress.double() / self.loaded).clamp(max=1)

    def stuck_radius(self, progress: Tensor) -> Tensor:
        friction = self.static_friction, self.kinetic_friction
        area = stuck_area(self.load_ratio(progress), *friction)
        if self.loaded < self.full_slip:
            left = (self.full_slip - progress.double()) / (self.full_slip - self.loaded)
            area = torch.where(left < 1, critical_stuck_area(*friction) * left.clamp(min=0), area)
        # Near 0 the square root has no finite slope, which differentiation of the motion needs.
        return torch.where(area > 1e-12, area.clamp(min=1e-12).sqrt(), 0.0).to(progress.dtype)

    def _slip(self, radius: Tensor, progress: Tensor) -> Tensor:
        stuck = self.stuck_radius(progress)
        crept = self.creep * (_rounded_ramp(radius - stuck) - _rounded_ramp(radius - 1))
        return crept + self.jumped(progress) * _smoothstep((radius - stuck) / (1 - stuck).clamp(min=1e-6))

    def radius_of_displacement(self, progress: float, limit: float) -> float:
        at = torch.tensor(progress, dtype=torch.float64)
        left = limit - float(self.travelled(at))
        if left <= 0:
            return 0.0

        # The displacement grows outwards, but only within the contact: the skin around it moves rigidly.
        def beyond(radius: float) -> float:
            return float(self._slip(torch.tensor(radius, dtype=torch.float64), at)) - left

        return float(brentq(beyond, float(self.stuck_radius(at)), 1.0, xtol=1e-15)) if beyond(1.0) > 0 else 1.0

    def tangential_force(self, time: Array) -> Array:
        progress = self.progress(time)
        held = self.load_ratio(torch.from_numpy(progress)).numpy()
        slipping = np.clip((progress - self.full_slip) * self.times[-1] / self.collapse, 0, 1)
        return self.force * (held + slipping * (self.kinetic_friction - held))


def _smoothstep(share: Tensor) -> Tensor:
    share = share.clamp(0, 1)
    return share.square() * (3 - 2 * share)


def _rounded_ramp(distance: Tensor) -> Tensor:
    """Return max(x, 0) with a rounded kink: sqrt(x² + a²) - a for positive distances x, 0 for negative ones, with a =
    `_ROUNDED`.
    """
    return torch.hypot(distance.clamp(min=0), torch.full_like(distance, _ROUNDED)) - _ROUNDED
