"""Motion and contact of the skin in closed form: the material coordinates at every position on the glass.

Only the inverse map is defined, material = phi(position, progress), so that an image is an evaluation at its
pixels; forward positions and all derivatives follow from it in `fingerflow.synthetic.truth`. Time enters only as
the progress of the movement from 0 to 1, so results do not depend on its speed.
Positions are in mm on the glass, x right, y down.
"""

import math
from dataclasses import dataclass
from typing import Protocol

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


class SkinMotion(Protocol):
    """Interface of a skin motion: skin and contact edge as functions of position (x, y) on the glass, mm, and progress
    of the movement, which is 0 at its start.
    """

    #: Number of intervals of the progress in the search for the onset; each contains one entry at most.
    entry_steps: int

    def material(self, x: Tensor, y: Tensor, progress: Tensor) -> tuple[Tensor, Tensor]:
        """Return the material coordinates (mm), the positions in undeformed skin, of the skin that lies at positions
        (x, y) mm on the glass at a progress of the movement.
        """

    def depth(self, x: Tensor, y: Tensor, progress: Tensor) -> Tensor:
        """Return how deep positions (x, y) mm lie inside the apparent contact at a progress of the movement, as a
        dimensionless number: positive inside, 0 on the edge, negative outside.
        """

    def ellipse(self, progress: float) -> Ellipse | None:
        """Return the elliptic edge of the apparent contact at a progress of the movement, or None without contact."""


@dataclass(frozen=True)
class PressMotion:
    """Motion of skin pressed on glass: contact grows from a point to the ellipse `contact`, while skin moves by a
    uniform `gradient` and `shift` and by local `bumps`.

    Progress is the length of the contact as a share of its final length. Contact area grows with the square root of the
    force and skin displacement with the force itself, that is with progress⁴:
    material = position - progress⁴ (gradient (position - centre) + shift + bumps).

    Args:
        contact: the apparent contact at the end.
        gradient: ((du/dx, du/dy), (dv/dx, dv/dy)) of the uniform part: dilation, shear and rotation.
        shift: uniform displacement, mm.
        bumps: non-uniform displacements.
    """

    contact: Ellipse
    gradient: tuple[tuple[float, float], tuple[float, float]]
    shift: tuple[float, float]
    bumps: tuple[Bump, ...]

    # The contact grows faster than the skin spreads, so a point inside it stays inside and enters only once.
    entry_steps = 1

    def material(self, x: Tensor, y: Tensor, progress: Tensor) -> tuple[Tensor, Tensor]:
        right, down = x - self.contact.centre[0], y - self.contact.centre[1]
        (xx, xy), (yx, yy) = self.gradient
        field_x = (xx * right).add(down, alpha=xy).add(self.shift[0])
        field_y = (yx * right).add(down, alpha=yy).add(self.shift[1])
        for bump in self.bumps:
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


@dataclass(frozen=True)
class SlideMotion:
    """Motion of a slide: skin slips from the rim of a constant contact inwards, then all skin slides along `direction`.

    Until `full_slip` (a progress) the stuck ellipse, `stuck_radius` times the contact, shrinks to nothing while the
    rim slips by up to `creep` mm. Then contact and skin travel `travel` mm together. With r the relative radius in the
    contact, material = position - direction (creep q (1 - exp(-((r - stuck_radius) / 0.6)²)) + travelled) outside the
    stuck ellipse and position - direction travelled inside it, q = progress / full_slip up to 1. The displacement has a
    continuous gradient.
    """

    contact: Ellipse
    direction: tuple[float, float]
    creep: float
    travel: float
    full_slip: float

    # Skin can enter and leave the contact. A stay shorter than 1/64 of the movement may be missed.
    entry_steps = 64

    def stuck_radius(self, progress: Tensor) -> Tensor:
        """Return the radius of the ellipse of stuck skin as a fraction of the contact's at a progress of the slide; its
        square is the stuck area share d².
        """
        return 1 - self._slip_progress(progress).square()

    def travelled(self, progress: Tensor) -> Tensor:
        """Return the distance, mm, by which contact and skin have slid together up to a progress of the slide."""
        return self.travel * ((progress - self.full_slip) / (1 - self.full_slip)).clamp(min=0).square()

    def material(self, x: Tensor, y: Tensor, progress: Tensor) -> tuple[Tensor, Tensor]:
        travelled = self.travelled(progress)
        radius = self.contact.radius(x - travelled * self.direction[0], y - travelled * self.direction[1])
        beyond = (radius - self.stuck_radius(progress)).clamp(min=0) / 0.6
        slipped = travelled - self.creep * self._slip_progress(progress) * torch.expm1(-beyond.square())
        return x - slipped * self.direction[0], y - slipped * self.direction[1]

    def depth(self, x: Tensor, y: Tensor, progress: Tensor) -> Tensor:
        travelled = self.travelled(progress)
        return 1 - self.contact.radius(x - travelled * self.direction[0], y - travelled * self.direction[1])

    def ellipse(self, progress: float) -> Ellipse | None:
        travelled = float(self.travelled(torch.tensor(progress, dtype=torch.float64)))
        (x, y), (right, down) = self.contact.centre, self.direction
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

    def _slip_progress(self, progress: Tensor) -> Tensor:
        """Return the progress of partial slip at a progress of the whole slide: 0 at the start, 1 from full slip on."""
        return (progress / self.full_slip).clamp(max=1)
