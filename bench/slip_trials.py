"""Trials of partial slip beyond the model: other decays of slip beside the stick border, and a linear stuck area."""

from dataclasses import dataclass

import torch
from torch import Tensor

from fingerflow.synthetic import LinearSlip, PartialSlip

#: Laws by which displacement begins beside the stick region: powers of the distance, the half-space's
#: logarithm where friction is discontinuous (mu_s > mu_k), and the rounded line of `PartialSlip`.
LAWS = ("rounded", "x^1", "x ln 1/x", "x^1.5", "x^2")
_SHORTEST = 0.01  # relative distance below which the logarithm ends, as a strain of more than 1 folds the skin
_STEEP = 0.5  # of the creep, for the same reason


@dataclass(frozen=True, kw_only=True)
class LawSlip(LinearSlip):
    """A `LinearSlip` with a law of `LAWS` beside its stick border.

    Args:
        law: with x the relative distance from the border, the skin has moved by `creep` L(x).
        linear: whether d² falls in a straight line; else it follows the model, as in `PartialSlip`.
    """

    law: str = "rounded"
    linear: bool = False

    def stuck_radius(self, progress: Tensor) -> Tensor:
        return super().stuck_radius(progress) if self.linear else PartialSlip.stuck_radius(self, progress)

    def _slip(self, radius: Tensor, progress: Tensor) -> Tensor:
        if self.law == "rounded":
            return super()._slip(radius, progress)
        beyond = (radius.clamp(max=1) - self.stuck_radius(progress)).clamp(min=0)
        if self.law == "x ln 1/x":
            return _STEEP * self.creep * beyond * (1 - torch.log(beyond + _SHORTEST))
        return self.creep * beyond ** float(self.law.removeprefix("x^"))
