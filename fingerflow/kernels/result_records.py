"""Records of what kernels, ops and engines return: of NumPy arrays, or of torch tensors."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Values = Any  # NumPy array, or torch tensor


class FrameContact(NamedTuple):
    """Contact of K frames, in px of the contact view; ellipses are NaN without contact.

    Attributes:
        real_contact_mask: (K, 1, H, W) bool, the micro-junctions; None if the engine does not return it.
        real_area_px, gross_area_px: (K,) px, areas of the real and of the apparent (gross) contact.
        center, semi_axes: (K, 2) px, ellipse of the apparent contact; its angle (K,) rad, from x towards y.
        density_margin: (K, 1, h, w) of the apparent contact on cells, an input of `engines.contact_view.covers`.
        illumination_gain: (K,) gain of the light relative to the empty glass; NaN where no glass is visible, None if it
            is not measured.
        threshold: (K,) relative intensity loss above which a pixel touches, NaN without contact; None if not stated.
    """

    real_contact_mask: Values | None
    real_area_px: Values
    gross_area_px: Values
    center: Values
    semi_axes: Values
    angle: Values
    density_margin: Values
    illumination_gain: Values = None
    threshold: Values = None


class TrackedPoints(NamedTuple):
    """Results of tracking N points in K frames; positions of lost points are NaN.

    Attributes:
        points: (K, N, 2) px, NaN where the status is not TRACKED.
        error: (K, N) px, forward-backward distance.
        covariance: (K, N, 2, 2) px^2, NaN as the points.
        status: (K, N) uint8 (`kernels.tracking_limits.TrackStatus`).
        estimate: (K, N, 2) px, position from which the search continues; that of a tracked point is `points`.
    """

    points: Values
    error: Values
    covariance: Values
    status: Values
    estimate: Values

    @property
    def variance(self) -> Values:
        """Return the position variance (K, N), px^2: the mean of the variances in x and y."""
        return (self.covariance[..., 0, 0] + self.covariance[..., 1, 1]) / 2


class FrameEllipse(NamedTuple):
    """Ellipses of the apparent contact of K frames, in the length unit of the points: center (K, 2), semi_axes (K, 2),
    angle (K,) rad from x towards y; NaN in frames without contact.
    """

    center: Values
    semi_axes: Values
    angle: Values

    def select(self, frames: slice | NDArray[np.intp]) -> FrameEllipse:
        """Return the border ellipses of the given frames, a slice or indices."""
        return FrameEllipse(self.center[frames], self.semi_axes[frames], self.angle[frames])

    def inside(self, positions: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the distance (frames, P), mm, of positions (frames, P, 2) from the border ellipse of their frame,
        positive inside the ellipse and negative outside.

        It is accurate to first order, and exact on the border.
        """
        # Compute each component separately: NumPy takes several times as long for sums over an axis of two.
        (center_x, center_y), (first, second) = self.center.T[..., None], self.semi_axes.T[..., None]
        cosine, sine = np.cos(self.angle)[:, None], np.sin(self.angle)[:, None]
        right, down = positions[..., 0] - center_x, positions[..., 1] - center_y
        along, across = (right * cosine + down * sine) / first, (down * cosine - right * sine) / second
        radius = np.sqrt(along * along + across * across)
        along, across = along / first, across / second
        slope = np.sqrt(along * along + across * across)
        return (1 - radius) * radius / np.maximum(slope, 1e-12)


class EnteredPoints(NamedTuple):
    """Points that moved into the contact (advected), with displacement gradients since each point's entry.

    A gradient between displacements from different onsets has no meaning. An entered point therefore has the gradient
    of the displacements, its own and its neighbours', since its own entry. It is left out of the fits of other points.

    Attributes:
        among: (K, N) bool, True for the points that were advected.
        gradient: (K, N, 2, 2), NaN where it is not known.
        covariance: (K, N, 2, 2, 2, 2) of the gradient, or None.
    """

    among: Values
    gradient: Values
    covariance: Values | None


class FrameFields(NamedTuple):
    """Divergence, curl, strain and shear at N points in K frames, and medians over the contact.

    Attributes:
        divergence, curl: (K, N), curl in rad; NaN where the displacement of the point itself is not known.
        strain: (K, N, 3) as (exx, eyy, exy).
        shear: (K, N, 2) along the axes and along the diagonals.
        divergence_std, curl_std: (K, N); None without covariances.
        median: (K, 5) of divergence, curl, exx, eyy, exy over the area of the ellipse; None without an ellipse.
        median_std: (K, 5); None without covariances or an ellipse.
        known_share: (K,) share of the ellipse in which the fields are known (`ops.fields.area_medians`); None without
            an ellipse.
    """

    divergence: Values
    curl: Values
    strain: Values
    shear: Values
    divergence_std: Values | None
    curl_std: Values | None
    median: Values
    median_std: Values | None
    known_share: Values


class LocalFit(NamedTuple):
    """Linear fits to values of C components around Q query positions; NaN where the points do not determine a fit."""

    value: Values  # (B, Q, C), the unit of the values
    gradient: Values  # (B, Q, C, 2), [..., i, j] = d value_i / d x_j, value unit per length unit
    covariance: Values | None  # (B, Q, C, 2, C, 2), [..., i, j, k, l] = cov(gradient_ij, gradient_kl)
    point_count: Values  # (B, Q) int64, number of usable points within the support
    centroid_offset: Values  # (B, Q), distance from the query to the weighted centroid of its points, length unit


class CorrectedPoints(NamedTuple):
    """Tracked points (N points in K frames) after correction for the deformation of the skin.

    Attributes:
        points: (K, N, 2) px.
        covariance: (K, N, 2, 2) px^2, without the part of the residual that is due to the deformation.
        warp: (K, N, 2, 2) deformation gradient since the key frame; the identity where it is not known.
        shift: (K, N) px by which the deformation has moved the edge of a window since its template was prepared.
        expected: (K, N, 2) px, position predicted from the neighbours of a point; NaN where too few are known.
    """

    points: Values
    covariance: Values
    warp: Values
    shift: Values
    expected: Values
