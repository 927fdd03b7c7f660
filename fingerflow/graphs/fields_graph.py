"""Divergence, curl and strain from displacements of scattered points, at the points and over the contact."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.kernels.result_records import EnteredPoints, FrameEllipse
from fingerflow.ops.fields.area_medians import Apart, area_medians
from fingerflow.ops.fields.point_gradients import point_gradients
from fingerflow.ops.fields.strain import curl, divergence, green_lagrange, shear
from fingerflow.ops.fields.strain_uncertainty import curl_std, divergence_std, field_std
from fingerflow.ops.full_precision import without_autocast
from fingerflow.ops.tensors import finite, sum_rows


class Fields(NamedTuple):
    """Divergence, curl, strain and shear at N points in B frames, and medians over the apparent contact.

    Attributes:
        divergence, curl: (B, N), curl in rad; NaN where the displacement of the point itself is not known.
        strain: (B, N, 3) as (exx, eyy, exy).
        shear: (B, N, 2) along the axes and along the diagonals.
        divergence_std, curl_std: (B, N); None without covariances.
        median: (B, 5) of divergence, curl, exx, eyy, exy over the area of the ellipse; None without an ellipse.
        median_std: (B, 5); None without covariances or an ellipse.
        known_share: (B,) share of the ellipse in which the fields are known; None without an ellipse.
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
    """Module that computes divergence, curl and strain from displacements of scattered points, by local fits.

    `ops.fields.point_gradients` computes the fields at the points, in reference coordinates;
    `ops.fields.area_medians` computes the medians over the contact.
    """

    def __init__(self, gauge_length: float, measure: str = "green_lagrange") -> None:
        super().__init__()
        self.gauge_length = gauge_length
        self.measure = measure

    @without_autocast
    def forward(
        self,
        reference: Tensor,
        displacement: Tensor,
        covariance: Tensor | None = None,
        ellipse: FrameEllipse | None = None,
        entered: EnteredPoints | None = None,
    ) -> Fields:
        """Compute divergence, curl, strain and their medians from reference positions and displacements of points.

        Positions and displacements have one length unit. Unknown displacements are NaN.

        Args:
            reference: (1 or B, N, 2).
            displacement: (B, N, 2).
            covariance: (B, N, 2, 2) of the displacements, with errors independent between points; None omits the
                standard deviations.
            ellipse: area of the medians; None omits them.
            entered: points whose displacement counts from their own entry.
        """
        rest = displacement if entered is None else torch.where(entered.among[..., None], torch.nan, displacement)
        gradient, spread = point_gradients(reference, rest, self.gauge_length, covariance)
        if entered is not None:
            # A point that entered and was lost has no gradient.
            own_points = entered.among & finite(sum_rows(displacement.mT))[:, 0]
            gradient = torch.where(own_points[..., None, None], entered.gradient, gradient)
            if spread is not None and entered.covariance is not None:
                spread = torch.where(own_points[..., None, None, None, None], entered.covariance, spread)
        median = median_std = known_share = None
        if ellipse is not None:
            median, median_std, known_share = area_medians(
                reference,
                displacement,
                *ellipse,
                gauge_length=self.gauge_length,
                measure=self.measure,
                covariance=covariance,
                apart=None if entered is None else _apart(entered, self.measure),
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


def _apart(entered: EnteredPoints, measure: str) -> Apart:
    """Return the entered points with their divergence, curl and strain (of the given `measure`), computed from
    displacement gradients, for medians that do not fit these points again.
    """
    first = torch.stack((divergence(entered.gradient), curl(entered.gradient)), dim=-1)
    fields = torch.cat((first, green_lagrange(entered.gradient, measure)), dim=-1)
    std = None if entered.covariance is None else field_std(entered.gradient, entered.covariance, measure)
    return Apart(entered.among, fields, std)
