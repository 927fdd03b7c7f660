"""Divergence, curl and strain from displacements of scattered points, at the points and over the contact."""

import torch
from torch import Tensor, nn

from fingerflow.kernels.field_limits import SHARPENED, SHARPENED_NOISE
from fingerflow.kernels.result_records import EnteredPoints, FrameEllipse, FrameFields
from fingerflow.ops.fields.area_medians import area_medians
from fingerflow.ops.fields.point_gradients import point_gradients
from fingerflow.ops.fields.strain import curl, divergence, green_lagrange, shear
from fingerflow.ops.fields.strain_uncertainty import curl_std, divergence_std
from fingerflow.ops.full_precision import without_autocast
from fingerflow.ops.tensors import finite, sum_rows


class FieldsGraph(nn.Module):
    """Module that computes divergence, curl and strain from displacements of scattered points, by local fits.

    `ops.fields.point_gradients` computes the fields at the points, in reference coordinates;
    `ops.fields.area_medians` computes the medians over the contact, of sharpened displacements (`SHARPENED`).
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
    ) -> FrameFields:
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
        gradient, spread, fitted = point_gradients(reference, rest, self.gauge_length, covariance)
        if entered is not None:
            # A point that entered and was lost has no gradient.
            own_points = entered.among & finite(sum_rows(displacement.mT))[:, 0]
            gradient = torch.where(own_points[..., None, None], entered.gradient, gradient)
            if spread is not None and entered.covariance is not None:
                spread = torch.where(own_points[..., None, None, None, None], entered.covariance, spread)
        median = median_std = known_share = None
        if ellipse is not None:
            added = SHARPENED * (rest - fitted)
            points = reference, displacement + torch.where(finite(added), added, 0.0), ellipse
            noise = None if covariance is None else SHARPENED_NOISE * covariance
            median, median_std, known_share = area_medians(
                *points, gauge_length=self.gauge_length, measure=self.measure, covariance=noise, entered=entered
            )
        return FrameFields(
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
