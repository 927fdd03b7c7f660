"""Synthetic slide: a fingertip pulled over glass at constant normal force until its contact slips as a whole."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from fingerflow.synthetic.motion import Ellipse
from fingerflow.synthetic.scenes import Array, SyntheticScene


@dataclass(frozen=True, kw_only=True)
class Slide(SyntheticScene):
    """Synthetic slide: the stick region shrinks from the rim to nothing, then skin and contact travel together.

    The contact exists from the first frame; the pull begins at the trigger. Until full slip the stuck ellipse,
    `stuck_radius` times the contact, shrinks to nothing while the rim slips by up to `creep` mm. Then contact and skin
    travel `travel` mm together. With r the relative radius in the contact, material = position - way (creep q
    (1 - exp(-((r - stuck_radius) / 0.6)²)) + travelled) outside the stuck ellipse and position - way travelled inside
    it, q = progress / full_slip up to 1. The displacement has a continuous gradient. The tangential force is that of
    Terekhov & Hayward (2011), T/N = 2 mu_s d² (1 - d²) + mu_k (1 - d²)², for the current relative stuck area d².
    Settings that all scenes share are those of `SyntheticScene`; lengths in mm, angles in rad, times in s, forces in N.

    Args:
        force: normal force.
        static_friction: mu_s.
        kinetic_friction: mu_k.
        semi_axes: of the apparent contact.
        tilt: angle from x to its first semi-axis, towards y.
        direction: angle of the pull from x, towards y.
        creep: displacement of the skin far from the stick region before the contact slips as a whole.
        travel: displacement of the whole contact from then to the last frame.
        full_slip: time of full slip, as a share of the time from the trigger to the last frame.
    """

    force: float = 2.0
    static_friction: float = 1.0
    kinetic_friction: float = 0.6
    semi_axes: tuple[float, float] = (5.0, 4.2)
    tilt: float = 0.14
    direction: float = 0.1
    creep: float = 0.8
    travel: float = 2.0
    full_slip: float = 0.6

    # Skin can enter and leave the contact. A stay shorter than 1/64 of the movement may be missed.
    entry_steps = 64

    @cached_property
    def way(self) -> tuple[float, float]:
        """Return the unit vector (x, y) of the pull."""
        return math.cos(self.direction), math.sin(self.direction)

    @cached_property
    def contact(self) -> Ellipse:
        """Return the edge of the apparent contact in the first frame."""
        # Centre the travel on the middle of the view, where the light is.
        (x, y), (right, down) = self.contact_centre, self.way
        return Ellipse((x - self.travel / 2 * right, y - self.travel / 2 * down), self.semi_axes, self.tilt)

    def stuck_radius(self, progress: Tensor) -> Tensor:
        """Return the radius of the ellipse of stuck skin as a fraction of the contact's at a progress of the slide; its
        square is the stuck area share d².
        """
        return 1 - self._slip_progress(progress).square()

    def travelled(self, progress: Tensor) -> Tensor:
        """Return the distance, mm, over which contact and skin have slid as one body at `progress` (0 to 1)."""
        return self.travel * ((progress - self.full_slip) / (1 - self.full_slip)).clamp(min=0).square()

    def material(self, x: Tensor, y: Tensor, progress: Tensor) -> tuple[Tensor, Tensor]:
        travelled = self.travelled(progress)
        radius = self.contact.radius(x - travelled * self.way[0], y - travelled * self.way[1])
        slipped = travelled + self._slip(radius, progress)
        return x - slipped * self.way[0], y - slipped * self.way[1]

    def depth(self, x: Tensor, y: Tensor, progress: Tensor) -> Tensor:
        travelled = self.travelled(progress)
        return 1 - self.contact.radius(x - travelled * self.way[0], y - travelled * self.way[1])

    def ellipse(self, progress: float) -> Ellipse | None:
        travelled = float(self.travelled(torch.tensor(progress, dtype=torch.float64)))
        (x, y), (right, down) = self.contact.centre, self.way
        return Ellipse((x + travelled * right, y + travelled * down), self.contact.semi_axes, self.contact.angle)

    def radius_of_displacement(self, progress: float, limit: float) -> float:
        """Return the radius, relative to that of the contact, within which skin has moved by less than `limit` mm since
        the start.

        It is 0 if no skin has moved less, and infinite if all has.
        """
        at = torch.tensor(progress, dtype=torch.float64)
        travelled, creep = float(self.travelled(at)), self.creep * float(self._slip_progress(at))
        if travelled >= limit:
            return 0.0
        share = (limit - travelled) / creep if creep > 0 else math.inf
        if share >= 1:
            return math.inf
        return float(self.stuck_radius(at)) + 0.6 * math.sqrt(-math.log1p(-share))

    def _slip(self, radius: Tensor, progress: Tensor) -> Tensor:
        """Return the slip, mm, of skin at a radius relative to the contact's at a progress of the slide."""
        beyond = (radius - self.stuck_radius(progress)).clamp(min=0) / 0.6
        return -self.creep * self._slip_progress(progress) * torch.expm1(-beyond.square())

    def _slip_progress(self, progress: Tensor) -> Tensor:
        """Return the progress of partial slip at a progress of the whole slide: 0 at the start, 1 from full slip on."""
        return (progress / self.full_slip).clamp(max=1)

    def progress(self, time: Array) -> Array:
        return np.clip(time / self.times[-1], 0, 1)

    def normal_force(self, time: Array) -> Array:
        return np.full_like(time, self.force)

    def tangential_force(self, time: Array) -> Array:
        slipping = 1 - self._stuck_share(self.progress(time))
        mu_s, mu_k = self.static_friction, self.kinetic_friction
        return self.force * slipping * (2 * mu_s * (1 - slipping) + mu_k * slipping)

    def stuck_share(self, frame: int) -> float:
        """Return the stuck area share d² of a frame: the part of the contact that has not slipped at all."""
        return float(self._stuck_share(self.progress(self.times[frame])))

    def slow_share(self, frame: int, limit_mm: float = 0.04) -> float:
        """Return the share of the contact area whose skin has moved by less than `limit_mm` since the start of the
        slide.

        A camera takes this share for the stick region. The limit of Terekhov & Hayward (2011) is 40 um.
        """
        radius = self.radius_of_displacement(float(self.progress(self.times[frame])), limit_mm)
        return min(radius, 1.0) ** 2

    def _stuck_share(self, progress: Array) -> Array:
        return self.stuck_radius(torch.from_numpy(np.asarray(progress, dtype=np.float64))).square().numpy()
