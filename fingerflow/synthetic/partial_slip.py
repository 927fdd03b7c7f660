"""A trial of tangential loading: T ramps up under a constant N until the stuck part of the contact is lost."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from fingerflow.models.partial_slip import critical_load_ratio, critical_stuck_area, stuck_area
from fingerflow.synthetic.motion import SlideMotion
from fingerflow.synthetic.scenes import Array
from fingerflow.synthetic.slide import Slide

_ROUNDED = 0.1  # relative radius over which the skin beside the stuck part takes up its stretch


@dataclass(frozen=True, kw_only=True)
class PartialSlip(Slide):
    """A slide that its load drives: T/N rises evenly, and the stuck part is what the model leaves at that load.

    d² follows equation 5 of Terekhov & Hayward (2011) up to the critical load. Where the kinetic friction is the
    smaller one, the critical area then collapses at constant load, evenly in time; else it has faded to nothing. From
    then on contact and skin travel together, and T/N falls to mu_k within the time of a collapse. The truth of a frame
    is `stuck_share`, d²; `slow_share`, what a limit of displacement takes for it; and `truth`, where each point is.

    Settings are those of `Slide`; here `creep` is how far skin at the rim of the contact has gone when nothing is stuck
    any more: about its stretch along the pull (0.2 by default) times a semi-axis.

    Args:
        collapse: s from the critical area to none.
        jumps: s at which contact and skin jump together by `jump` mm along the pull, as in stick-slip: after full slip.
        jump: mm of one jump; 5 px of the contact view are 0.1625 mm.

    Raises:
        ValueError: a jump before full slip, when a part of the contact sticks.
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
        full_slip = self.full_slip * float(self.times[-1])
        if any(time < full_slip for time in self.jumps):
            raise ValueError(
                f"jumps at {self.jumps} s: one is before full slip at {full_slip:.3f} s, and skin that sticks does not "
                f"jump; make it later"
            )

    @cached_property
    def motion(self) -> "PartialSlipMotion":
        slide = super().motion
        critical = float(critical_stuck_area(self.static_friction, self.kinetic_friction).nan_to_num(0.0))
        collapse = self.collapse / self.times[-1] if critical > 0 else 0.0
        return PartialSlipMotion(
            slide.contact,
            slide.direction,
            slide.creep,
            slide.travel,
            slide.full_slip,
            self.static_friction,
            self.kinetic_friction,
            self.full_slip - collapse,
            tuple(float(time / self.times[-1]) for time in self.jumps),
            self.jump,
        )

    def tangential_force(self, time: Array) -> Array:
        progress = self.progress(time)
        held = self.motion.load_ratio(torch.from_numpy(progress)).numpy()
        slipping = np.clip((progress - self.full_slip) * self.times[-1] / self.collapse, 0, 1)
        result: Array = self.force * (held + slipping * (self.kinetic_friction - held))
        return result


@dataclass(frozen=True)
class PartialSlipMotion(SlideMotion):
    """A `SlideMotion` whose stuck ellipse has the area of the model, its load even in progress up to `loaded`.

    With r the relative radius in the contact and s that of the stuck ellipse, skin outside it has gone
    creep (f(r - s) - f(r - 1)), f(x) = sqrt(x² + 0.1²) - 0.1 for x > 0 and 0 below: from the border of the stuck part
    it takes up an even stretch, and beyond the contact it moves as one. Nothing has moved where s = 1.

    Args:
        static_friction: mu_s.
        kinetic_friction: mu_k.
        loaded: progress at which the critical load is reached.
        jumps: progress of each jump.
        jump: how far each goes, mm.
    """

    static_friction: float
    kinetic_friction: float
    loaded: float
    jumps: tuple[float, ...] = ()
    jump: float = 0.0

    def travelled(self, progress: Tensor) -> Tensor:
        """How far contact and skin have gone together, mm, jumps among it."""
        result = super().travelled(progress)
        for at in self.jumps:
            result = result + self.jump * (progress >= at).to(progress.dtype)
        return result

    def load_ratio(self, progress: Tensor) -> Tensor:
        """T/N while any part is stuck, float64."""
        critical = critical_load_ratio(self.static_friction, self.kinetic_friction)
        return critical * (progress.double() / self.loaded).clamp(max=1)

    def stuck_radius(self, progress: Tensor) -> Tensor:
        friction = self.static_friction, self.kinetic_friction
        area = stuck_area(self.load_ratio(progress), *friction)
        if self.loaded < self.full_slip:
            left = (self.full_slip - progress.double()) / (self.full_slip - self.loaded)
            area = torch.where(left < 1, critical_stuck_area(*friction) * left.clamp(min=0), area)
        # Below, a root has no slope to derive the motion with.
        return torch.where(area > 1e-12, area.clamp(min=1e-12).sqrt(), 0.0).to(progress.dtype)

    def material(self, x: Tensor, y: Tensor, progress: Tensor) -> tuple[Tensor, Tensor]:
        travelled = self.travelled(progress)
        radius = self.contact.radius(x - travelled * self.direction[0], y - travelled * self.direction[1])
        stretched = _stretched(radius - self.stuck_radius(progress)) - _stretched(radius - 1)
        slipped = travelled + self.creep * stretched
        return x - slipped * self.direction[0], y - slipped * self.direction[1]

    def radius_of_displacement(self, progress: float, limit: float) -> float:
        at = torch.tensor(progress, dtype=torch.float64)
        left = limit - float(self.travelled(at))
        if left <= 0:
            return 0.0
        beyond = math.sqrt((left / self.creep + _ROUNDED) ** 2 - _ROUNDED**2) if self.creep > 0 else math.inf
        # In the contact alone: the skin around it moves as one.
        return min(float(self.stuck_radius(at)) + beyond, 1.0)


def _stretched(beyond: Tensor) -> Tensor:
    return torch.hypot(beyond.clamp(min=0), torch.full_like(beyond, _ROUNDED)) - _ROUNDED
