"""Synthetic trial of partial slip whose stuck area decreases linearly with the tangential force.

Terekhov & Hayward 2011 measured such a decrease.
"""

from dataclasses import dataclass, fields
from functools import cached_property

import torch
from torch import Tensor

from fingerflow.synthetic import PartialSlip
from fingerflow.synthetic.partial_slip import PartialSlipMotion


@dataclass(frozen=True, kw_only=True)
class LinearSlip(PartialSlip):
    """A `PartialSlip` with d² = 1 - (1 - last) T / T_max up to the largest load, then a fall to 0 at this load.

    Args:
        last: d² at which the collapse begins; kinetic friction is the smaller one.
    """

    last: float = 0.2
    kinetic_friction: float = 0.4

    @cached_property
    def motion(self) -> "LinearSlipMotion":
        model = super().motion
        return LinearSlipMotion(**{one.name: getattr(model, one.name) for one in fields(model)}, last=self.last)


@dataclass(frozen=True)
class LinearSlipMotion(PartialSlipMotion):
    """A `PartialSlipMotion` whose stuck area is linear in the load down to `last`."""

    last: float = 0.2

    def stuck_radius(self, progress: Tensor) -> Tensor:
        share = progress.double() / self.loaded
        left = (self.full_slip - progress.double()) / (self.full_slip - self.loaded)
        area = torch.where(left < 1, self.last * left.clamp(min=0), 1 - (1 - self.last) * share)
        return torch.where(area > 1e-12, area.clamp(min=1e-12).sqrt(), 0.0).to(progress.dtype)
