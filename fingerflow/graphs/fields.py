"""Displacements of scattered points to divergence, curl and strain, at the points and over the contact."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.ops.area_medians import area_medians
from fingerflow.ops.point_gradients import point_gradients
from fingerflow.ops.strain import curl, divergence, green_lagrange
from fingerflow.ops.strain_uncertainty import curl_deviation, divergence_deviation


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
        divergence_std, curl_std: (B, N); None without covariances.
        median: (B, 5) of divergence, curl, exx, eyy, exy over the area of the ellipse; None without one.
        median_std: (B, 5); None without covariances.
    """

    divergence: Tensor
    curl: Tensor
    strain: Tensor
    divergence_std: Tensor | None
    curl_std: Tensor | None
    median: Tensor | None
    median_std: Tensor | None


class FieldsGraph(nn.Module):
    """Displacements of scattered points to divergence, curl and strain by local fits over ``gauge_length``.

    At the points by `ops.point_gradients` in reference coordinates, over the contact by `ops.area_medians`.
    """

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
        median = median_std = None
        if ellipse is not None:
            median, median_std = area_medians(
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
            None if spread is None else divergence_deviation(spread),
            None if spread is None else curl_deviation(spread),
            median,
            median_std,
        )


class SkinFields(NamedTuple):
    """What `SkinFieldsGraph` gives of B frames: at N points, NaN where not known, and `median_divergence` (B,)."""

    divergence: Tensor
    curl: Tensor
    strain: Tensor
    median_divergence: Tensor


class SkinFieldsGraph(nn.Module):
    """`FieldsGraph` of points in pixels of the topographic view, with lengths in pixels of the contact view.

    Args:
        gauge_px: diameter of the support of a fit, px of the contact view.
    """

    def __init__(self, gauge_px: float, precision: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.precision = precision
        self.fields = FieldsGraph(gauge_px)

    def forward(
        self,
        points: Tensor,
        reference: Tensor,
        topography_to_contact: Tensor,
        center: Tensor,
        semi_axes: Tensor,
        angle: Tensor,
    ) -> SkinFields:
        """Positions (B, N, 2) now and at the onset of contact, px, NaN where there is none; transform (2, 3) to pixels
        of the contact view, in which the ellipse of the gross contact is given."""
        matrix = topography_to_contact.to(self.precision)
        now, then = (one.to(self.precision) @ matrix[:, :2].T for one in (points, reference))
        fields = self.fields(then + matrix[:, 2], now - then, None, GrossEllipse(center, semi_axes, angle))
        assert fields.median is not None
        return SkinFields(fields.divergence, fields.curl, fields.strain, fields.median[:, 0])
