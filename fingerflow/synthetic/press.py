"""Synthetic press of a fingertip on glass: contact grows from a point while the skin spreads."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from torch import Tensor

from fingerflow.synthetic.motion import Bump, Ellipse
from fingerflow.synthetic.scenes import Array, SyntheticScene


@dataclass(frozen=True, kw_only=True)
class Press(SyntheticScene):
    """Synthetic press of a fingertip, with a force that rises as sin² to its maximum and stays there.

    Contact area grows with the square root of the force and skin displacement with the force itself, so late loading
    spreads skin that touches already. Progress is the length of the contact as a share of its final length: material =
    position - progress⁴ (gradient (position - centre) + shift + bumps). The default settings give a divergence of about
    12 % at the centre and a global displacement of a few pixels. Settings that all scenes share are those of
    `SyntheticScene`; lengths in mm, angles in rad, times in s, forces in N.

    Args:
        force: at the end.
        contact_time: first contact, counted from the trigger.
        rise_time: from first contact to the full force.
        semi_axes: of the apparent contact at the end.
        tilt: angle from x to its first semi-axis, towards y.
        gradient: ((du/dx, du/dy), (dv/dx, dv/dy)) of the uniform part of the displacement by the final position.
        shift: uniform part of the displacement at the end.
        bumps: local displacements at the end; their centres are counted from the centre of the contact.
        drag: tangential force as a share of the normal force.
    """

    force: float = 5.0
    contact_time: float = 0.02
    rise_time: float = 0.9
    semi_axes: tuple[float, float] = (5.5, 4.5)
    tilt: float = 0.14
    gradient: tuple[tuple[float, float], tuple[float, float]] = ((0.032, -0.008), (0.02, 0.028))
    shift: tuple[float, float] = (0.12, -0.08)
    bumps: tuple[Bump, ...] = (
        Bump(centre=(0.3, 0.2), width=3.2, dilation=0.036),
        Bump(centre=(-2.0, 1.6), width=2.2, shift=(0.05, -0.04)),
    )
    drag: float = 0.03

    @cached_property
    def contact(self) -> Ellipse:
        """Return the edge of the apparent contact at the end."""
        return Ellipse(self.contact_centre, self.semi_axes, self.tilt)

    @cached_property
    def _placed_bumps(self) -> list[Bump]:
        x, y = self.contact.centre
        return [replace(bump, centre=(x + bump.centre[0], y + bump.centre[1])) for bump in self.bumps]

    def material(self, x: Tensor, y: Tensor, progress: Tensor) -> tuple[Tensor, Tensor]:
        right, down = x - self.contact.centre[0], y - self.contact.centre[1]
        (xx, xy), (yx, yy) = self.gradient
        field_x = (xx * right).add(down, alpha=xy).add(self.shift[0])
        field_y = (yx * right).add(down, alpha=yy).add(self.shift[1])
        for bump in self._placed_bumps:
            bump_x, bump_y = bump(x, y)
            field_x, field_y = field_x + bump_x, field_y + bump_y
        return x - progress**4 * field_x, y - progress**4 * field_y

    def depth(self, x: Tensor, y: Tensor, progress: Tensor) -> Tensor:
        return progress - self.contact.radius(x, y)

    def ellipse(self, progress: float) -> Ellipse | None:
        if progress <= 0:
            return None
        first, second = self.contact.semi_axes
        return Ellipse(self.contact.centre, (progress * first, progress * second), self.contact.angle)

    def progress(self, time: Array) -> Array:
        return np.sqrt(np.sin(math.pi / 2 * self._share_of_rise(time)))

    def normal_force(self, time: Array) -> Array:
        return self.force * np.sin(math.pi / 2 * self._share_of_rise(time)) ** 2

    def tangential_force(self, time: Array) -> Array:
        return self.drag * self.normal_force(time)

    def _share_of_rise(self, time: Array) -> Array:
        return np.clip((time - self.contact_time) / self.rise_time, 0, 1)
