"""Displacements of scattered points to divergence, curl and strain, at the points and over the contact."""

from typing import ClassVar, NamedTuple

from torch import Tensor, nn

from fingerflow.ops.area_medians import area_medians
from fingerflow.ops.point_gradients import point_gradients
from fingerflow.ops.strain import curl, divergence, green_lagrange, shear
from fingerflow.ops.strain_uncertainty import curl_std, divergence_std


class GrossEllipse(NamedTuple):
    """The gross contact of B frames, in the length unit of the points."""

    center: Tensor  # (B, 2), x and y
    semi_axes: Tensor  # (B, 2)
    angle: Tensor  # (B,), from x towards y, rad


class Fields(NamedTuple):
    """Fields at N points of B frames, and medians over the gross contact.

    Attributes:
        divergence, curl: (B, N), curl in rad; NaN where the point itself is not known.
        strain: (B, N, 3) as (exx, eyy, exy).
        shear: (B, N, 2) along the axes and along the diagonals.
        divergence_std, curl_std: (B, N); None without covariances.
        median: (B, 5) of divergence, curl, exx, eyy, exy over the area of the ellipse; None without one.
        median_std: (B, 5); None without covariances.
        known_share: (B,) of the ellipse in which they are known; None without one.
    """

    divergence: Tensor
    curl: Tensor
    strain: Tensor
    shear: Tensor
    divergence_std: Tensor | None
    curl_std: Tensor | None
    median: Tensor | None
    median_std: Tensor | None
    known_share: Tensor | None


class FieldsGraph(nn.Module):
    """Displacements of scattered points to divergence, curl and strain by local fits over ``gauge_length``.

    At the points by `ops.point_gradients` in reference coordinates, over the contact by `ops.area_medians`.
    """

    point_axes: ClassVar = {"reference": 1, "displacement": 1, "covariance": 1}

    def __init__(self, gauge_length: float, measure: str = "green_lagrange") -> None:
        super().__init__()
        self.gauge_length = gauge_length
        self.measure = measure

    def forward(
        self,
        reference: Tensor,
        displacement: Tensor,
        covariance: Tensor | None = None,
        ellipse: GrossEllipse | None = None,
    ) -> Fields:
        """Reference positions (1 or B, N, 2) and displacements (B, N, 2) of one unit, NaN where not known.

        ``covariance`` (B, N, 2, 2) of the displacements, of errors that are independent from point to point, asks for
        standard deviations; ``ellipse`` for the medians.
        """
        gradient, spread = point_gradients(reference, displacement, self.gauge_length, covariance)
        median = median_std = known_share = None
        if ellipse is not None:
            median, median_std, known_share = area_medians(
                reference,
                displacement,
                *ellipse,
                gauge_length=self.gauge_length,
                measure=self.measure,
                covariance=covariance,
            )
        return Fields(
            divergence(gradient),
            curl(gradient),
            green_lagrange(gradient, self.measure),
            shear(gradient),
            None if spread is None else divergence_std(spread),
            None if spread is None else curl_std(spread),
            median,
            median_std,
            known_share,
        )
