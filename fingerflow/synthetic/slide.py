"""Synthetic slide: a fingertip pulled over glass at constant normal force until its contact slips as a whole."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from fingerflow.synthetic.motion import Ellipse, SlideMotion
from fingerflow.synthetic.scenes import Array, SyntheticScene


@dataclass(frozen=True, kw_only=True)
class Slide(SyntheticScene):
    """Synthetic slide: the stick region shrinks from the rim to nothing, then skin and contact travel together.

    The contact exists from the first frame; the pull begins at the trigger. The tangential force is that of
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

    @cached_property
    def motion(self) -> SlideMotion:
        # Centre the travel on the middle of the view, where the light is.
        right, down = math.cos(self.direction), math.sin(self.direction)
        x, y = self.contact_centre
        start = x - self.travel / 2 * right, y - self.travel / 2 * down
        return SlideMotion(
            Ellipse(start, self.semi_axes, self.tilt), (right, down), self.creep, self.travel, self.full_slip
        )

    def progress(self, time: Array) -> Array:
        return np.asarray(np.clip(time / self.times[-1], 0, 1))

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
        radius = self.motion.radius_of_displacement(float(self.progress(self.times[frame])), limit_mm)
        return min(radius, 1.0) ** 2

    def _stuck_share(self, progress: Array) -> Array:
        radius = self.motion.stuck_radius(torch.from_numpy(np.asarray(progress, dtype=np.float64)))
        return radius.square().numpy()
