"""Trials of partial slip beyond the model: other decays of slip beside the stick border, and a linear stuck area."""

from dataclasses import dataclass, fields
from functools import cached_property

import torch
from torch import Tensor

from fingerflow.synthetic import PartialSlip
from fingerflow.synthetic.partial_slip import PartialSlipMotion

#: Laws by which displacement begins beside the stick region: powers of the distance, the half-space's
#: logarithm where friction is discontinuous (mu_s > mu_k), and the rounded line of `PartialSlip`.
LAWS = ("rounded", "x^1", "x ln 1/x", "x^1.5", "x^2")
_SHORTEST = 0.01  # relative distance below which the logarithm ends, as a strain of more than 1 folds the skin
_STEEP = 0.5  # of the creep, for the same reason


@dataclass(frozen=True, kw_only=True)
class LawSlip(PartialSlip):
    """A `PartialSlip` with a law of `LAWS` beside its stick border.

    Args:
        law: with x the relative distance from the border, the skin has moved by `creep` L(x).
        last: d² at which a straight line d² = 1 - (1 - last) T / T_max ends, to fall to 0 at this load; None
            for d² by the model. With it kinetic friction is the smaller one.
    """

    law: str = "rounded"
    last: float | None = None

    @cached_property
    def motion(self) -> "LawSlipMotion":
        model = super().motion
        values = {one.name: getattr(model, one.name) for one in fields(model)}
        return LawSlipMotion(**values, law=self.law, last=self.last)


@dataclass(frozen=True)
class LawSlipMotion(PartialSlipMotion):
    """The motion of a `LawSlip`."""

    law: str = "rounded"
    last: float | None = None

    def stuck_radius(self, progress: Tensor) -> Tensor:
        if self.last is None:
            return super().stuck_radius(progress)
        left = (self.full_slip - progress.double()) / (self.full_slip - self.loaded)
        line = 1 - (1 - self.last) * progress.double() / self.loaded
        area = torch.where(left < 1, self.last * left.clamp(min=0), line)
        return torch.where(area > 1e-12, area.clamp(min=1e-12).sqrt(), 0.0).to(progress.dtype)

    def _slipped(self, radius: Tensor, stuck: Tensor, leapt: Tensor) -> Tensor:
        if self.law == "rounded":
            return super()._slipped(radius, stuck, leapt)
        beyond = (radius.clamp(max=1) - stuck).clamp(min=0)
        if self.law == "x ln 1/x":
            return _STEEP * self.creep * beyond * (1 - torch.log(beyond + _SHORTEST))
        return self.creep * beyond ** float(self.law.removeprefix("x^"))
