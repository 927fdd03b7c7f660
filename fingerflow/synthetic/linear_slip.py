"""Synthetic trial of partial slip whose stuck area falls linearly with load, as in Terekhov & Hayward 2011."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from fingerflow.synthetic.partial_slip import PartialSlip
from fingerflow.synthetic.scenes import Array

_SWING_HZ = 3.0


@dataclass(frozen=True, kw_only=True)
class LinearSlip(PartialSlip):
    """Synthetic trial of tangential loading whose stuck area share d² decreases with the tangential force from 1 to
    `last`, then collapses to 0.

    The stuck area relative to the contact area is d² = last + (1 - last) (1 - T / T_max)^bend, where T is the
    tangential force; it collapses at the largest one, T_max.

    The tangential force may swing: it is T (1 - swing sin²(pi 3 Hz t)), so that T is the largest force so far, which
    the stuck area follows.

    Args:
        last: d² at which the collapse begins; with 0 the area fades. Kinetic friction is the smaller one.
        bend: 1 for a straight line; above, the area fades faster at first.
        swing: relative depth of the swings of the tangential force.
    """

    last: float = 0.2
    bend: float = 1.0
    swing: float = 0.0

    def stuck_radius(self, progress: Tensor) -> Tensor:
        share = progress.double() / self.loaded
        rest = (1 - share).clamp(min=0) ** self.bend
        left = (self.full_slip - progress.double()) / (self.full_slip - self.loaded)
        area = torch.where(left < 1, self.last * left.clamp(min=0), self.last + (1 - self.last) * rest)
        return torch.where(area > 1e-12, area.clamp(min=1e-12).sqrt(), 0.0).to(progress.dtype)

    def tangential_force(self, time: Array) -> Array:
        return super().tangential_force(time) * (1 - self.swing * np.sin(np.pi * _SWING_HZ * time) ** 2)
