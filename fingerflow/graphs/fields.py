"""Displacements of scattered points to divergence, curl and strain."""

from typing import NamedTuple

from torch import Tensor, nn

from fingerflow.ops.local_fit import local_gradients
from fingerflow.ops.strain import curl, divergence, green_lagrange
from fingerflow.ops.strain_uncertainty import divergence_deviation


class Fields(NamedTuple):
    """Fields at Q places of B frames.

    Attributes:
        displacement: (B, Q, 2), unit of the positions.
        divergence, curl: (B, Q).
        strain: (B, Q, 3) as (exx, eyy, exy).
        divergence_std: (B, Q); None without variances.
    """

    displacement: Tensor
    divergence: Tensor
    curl: Tensor
    strain: Tensor
    divergence_std: Tensor | None


class FieldsGraph(nn.Module):
    """Displacements of scattered points to divergence, curl and strain by local fits over ``gauge_length``."""

    def __init__(self, gauge_length: float, measure: str = "green_lagrange") -> None:
        super().__init__()
        self.gauge_length = gauge_length
        self.measure = measure

    def forward(
        self,
        reference: Tensor,
        displacement: Tensor,
        variance: Tensor | None = None,
        queries: Tensor | None = None,
    ) -> Fields:
        """(B, N, 2) reference positions and displacements of one unit; variance (B, N) of a component in its square, if
        the standard deviation of the divergence is wanted.

        ``queries`` (B, Q, 2) are reference positions too; the points themselves by default.
        """
        fit = local_gradients(reference, displacement, queries, gauge_length=self.gauge_length, variance=variance)
        return Fields(
            fit.value,
            divergence(fit.gradient),
            curl(fit.gradient),
            green_lagrange(fit.gradient, self.measure),
            None if fit.covariance is None else divergence_deviation(fit.covariance),
        )
