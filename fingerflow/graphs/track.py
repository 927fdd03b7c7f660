"""Registration of key-frame templates in later frames, outlier detection and deformation correction."""

from typing import ClassVar, NamedTuple

from torch import Tensor, nn

from fingerflow.kernels.tracking_limits import WARP_GAUGE_PX
from fingerflow.ops.tracking.deformation import Supports, correct_points
from fingerflow.ops.tracking.outliers import Neighbours, Outliers, find_outliers
from fingerflow.ops.tracking.templates import Found, Templates, find_templates


class Deformed(NamedTuple):
    """Tracked points, corrected for the deformation of the skin since the preparation of the templates.

    Attributes:
        found: the points found, with corrected positions and covariances.
        warp: (K, N, 2, 2) deformation gradient since the key frame.
        shift: (K, N) px by which the deformation since the preparation of the template has moved the window's edge.
        expected: (K, N, 2) px, position of a point predicted by its neighbours; NaN where too few are known.
    """

    found: Found
    warp: Tensor
    shift: Tensor
    expected: Tensor


class DeformationGraph(nn.Module):
    """Module that estimates the deformation of the skin from tracked points and corrects the positions of the points.

    The method is that of `ops.tracking.deformation`.
    """

    point_axes: ClassVar = {"start": 1, "found": 1, "numbers": 1, "inverse_warp": 1}

    def __init__(self, window: int = 25) -> None:
        super().__init__()
        self.window = window

    def forward(
        self, start: Tensor, found: Found, numbers: Tensor, inverse_warp: Tensor, supports: Supports | None = None
    ) -> Deformed:
        """Correct the positions of points found in K frames for the deformation of the skin in the templates' windows,
        which is estimated from the displacements of the points since the key frame.

        `start` (1, N, 2) px are the positions of the points in the key frame. `numbers` (1, N, 32) are the template
        statistics (`Templates.numbers`), `inverse_warp` (1, N, 2, 2) the F_0^-1 with which the templates were prepared.
        `supports` are computed from `start` where they are None.
        """
        given = start, found.points, found.covariance, numbers, inverse_warp
        corrected = correct_points(*given, self.window, WARP_GAUGE_PX, supports)
        points, covariance, *others = corrected
        return Deformed(found._replace(points=points, covariance=covariance), *others)


class AgreementGraph(nn.Module):
    """Module that detects outliers: points that disagree with their neighbours, or have a far larger uncertainty."""

    point_axes: ClassVar = {"neighbours": 2, "start": 1, "points": 1, "position_std": 1}

    def forward(self, neighbours: Neighbours, start: Tensor, points: Tensor, position_std: Tensor) -> Outliers:
        """Return flags of the outliers among points (K, N, 2) px tracked in K frames: points whose displacement or
        uncertainty differs greatly from that of their neighbours.

        `position_std` (K, N) is the standard deviation of a component. `neighbours` is
        `ops.tracking.outliers.find_neighbours` of the positions `start` (1, N, 2) in the key frame.
        """
        return find_outliers(neighbours, points - start, position_std)


class TrackGraph(nn.Module):
    """Module that registers key-frame templates in a frame by one Lucas-Kanade step.

    Settings are those of `ops.tracking.templates.find_templates`.
    """

    point_axes: ClassVar = {"templates": 1, "prediction": 1}

    def __init__(self, forward_backward_limit: float = 1.0) -> None:
        super().__init__()
        self.forward_backward_limit = forward_backward_limit

    def forward(self, templates: Templates, view: Tensor, prediction: Tensor) -> Found:
        """Register the templates of (B, N) points in a view (B, 1, H, W), near predicted positions (B, N, 2) px."""
        return find_templates(templates, view, prediction, rounds=1, forward_backward_limit=self.forward_backward_limit)
