"""Points of a key frame of the topography view in the frames that follow."""

from typing import ClassVar, NamedTuple

from torch import Tensor, nn

from fingerflow.kernels.tracking_limits import WARP_GAUGE_PX
from fingerflow.ops.fields.plane_fit import Support
from fingerflow.ops.fields.point_gradients import neighbours_support
from fingerflow.ops.tracking.deformation import correct_points
from fingerflow.ops.tracking.outliers import Neighbours, Outliers, find_outliers
from fingerflow.ops.tracking.templates import Found, Templates, find_templates


class Deformed(NamedTuple):
    """What was found, corrected for the deformation of the templates, that deformation (K, N, 2, 2), px by which it has
    moved the edge of a window since the template was prepared (K, N), and where the neighbours of a point expect it
    (K, N, 2) px, NaN where too few are known.
    """

    found: Found
    warp: Tensor
    shift: Tensor
    expected: Tensor


class DeformationGraph(nn.Module):
    """Learns the deformation of the skin around its points from where they were found, and corrects the positions
    (`ops.tracking.deformation`).
    """

    point_axes: ClassVar = {"start": 1, "found": 1, "numbers": 1, "inverse_warp": 1}

    def __init__(self, window: int = 25) -> None:
        super().__init__()
        self.window = window

    def support(self, start: Tensor) -> Support | None:
        """What `forward` needs to know of the places (B, N, 2) px in the key frame; None where compiled kernels do
        without.
        """
        return neighbours_support(start, WARP_GAUGE_PX)

    def forward(
        self, start: Tensor, found: Found, numbers: Tensor, inverse_warp: Tensor, support: Support | None = None
    ) -> Deformed:
        """(1, N, 2) px in the key frame, what was found of K frames, `Templates.numbers` (1, N, 32) and F_0^-1
        (1, N, 2, 2) of the templates.
        """
        given = start, found.points, found.covariance, numbers, inverse_warp
        corrected = correct_points(*given, self.window, WARP_GAUGE_PX, support or self.support(start))
        points, covariance, *others = corrected
        return Deformed(found._replace(points=points, covariance=covariance), *others)


class AgreementGraph(nn.Module):
    """Points that were found but not where their neighbours say, or that are far more uncertain than they."""

    point_axes: ClassVar = {"neighbours": 2, "start": 1, "points": 1, "position_std": 1}

    def forward(self, neighbours: Neighbours, start: Tensor, points: Tensor, position_std: Tensor) -> Outliers:
        """`ops.tracking.outliers.find_neighbours` of the places (1, N, 2) in the key frame, and points (K, N, 2) and
        the standard deviation (K, N) of a component in K frames.
        """
        return find_outliers(neighbours, points - start, position_std)


class TrackGraph(nn.Module):
    """One step that looks for templates of a key frame in a frame; settings as in `ops.find_templates`."""

    point_axes: ClassVar = {"templates": 1, "prediction": 1}

    def __init__(self, forward_backward_limit: float = 1.0) -> None:
        super().__init__()
        self.forward_backward_limit = forward_backward_limit

    def forward(self, templates: Templates, view: Tensor, prediction: Tensor) -> Found:
        """Templates of (B, N) points, (B, 1, H, W) view, (B, N, 2) px."""
        return find_templates(templates, view, prediction, rounds=1, forward_backward_limit=self.forward_backward_limit)
