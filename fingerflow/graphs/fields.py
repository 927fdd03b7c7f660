"""Displacements of scattered points to divergence, curl and strain, at the points and over the contact."""

from typing import ClassVar, NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.ops.fields.area_medians import Apart, area_medians
from fingerflow.ops.fields.point_gradients import point_gradients
from fingerflow.ops.fields.strain import curl, divergence, green_lagrange, shear
from fingerflow.ops.fields.strain_uncertainty import curl_std, divergence_std, field_std
from fingerflow.ops.tensors import finite, sum_rows


class GrossEllipse(NamedTuple):
    """The gross contact of B frames, in the length unit of the points."""

    center: Tensor  # (B, 2), x and y
    semi_axes: Tensor  # (B, 2)
    angle: Tensor  # (B,), from x towards y, rad


class Entered(NamedTuple):
    """Those of N points in B frames that came into contact by moving into it. Displacements from onsets so far apart in
    time have no gradient: these points have that of the displacement since their own entry, their neighbours counted
    from that moment, and are no part of the fits of others.
    """

    among: Tensor  # (B, N) bool
    gradient: Tensor  # (B, N, 2, 2), NaN where it is not known
    covariance: Tensor | None  # (B, N, 2, 2, 2, 2) as `LocalFit` has it, where displacements have one

    def apart(self, measure: str) -> Apart:
        """For `area_medians`."""
        first = torch.stack((divergence(self.gradient), curl(self.gradient)), dim=-1)
        fields = torch.cat((first, green_lagrange(self.gradient, measure)), dim=-1)
        std = None if self.covariance is None else field_std(self.gradient, self.covariance, measure)
        return Apart(self.among, fields, std)


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

    At the points by `ops.fields.point_gradients` in reference coordinates, over the contact by
    `ops.fields.area_medians`.
    """

    point_axes: ClassVar = {"reference": 1, "displacement": 1, "covariance": 1, "entered": 1}

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
        entered: Entered | None = None,
    ) -> Fields:
        """Reference positions (1 or B, N, 2) and displacements (B, N, 2) of one unit, NaN where not known.

        ``covariance`` (B, N, 2, 2) of the displacements, of errors that are independent from point to point, asks for
        standard deviations; ``ellipse`` for the medians; ``entered`` says which points count from their own entry.
        """
        rest = displacement if entered is None else torch.where(entered.among[..., None], torch.nan, displacement)
        gradient, spread = point_gradients(reference, rest, self.gauge_length, covariance)
        if entered is not None:
            # Where a point is lost nothing is known of it.
            own = entered.among & finite(sum_rows(displacement.mT))[:, 0]
            gradient = torch.where(own[..., None, None], entered.gradient, gradient)
            if spread is not None and entered.covariance is not None:
                spread = torch.where(own[..., None, None, None, None], entered.covariance, spread)
        median = median_std = known_share = None
        if ellipse is not None:
            median, median_std, known_share = area_medians(
                reference,
                displacement,
                *ellipse,
                gauge_length=self.gauge_length,
                measure=self.measure,
                covariance=covariance,
                apart=None if entered is None else entered.apart(self.measure),
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
