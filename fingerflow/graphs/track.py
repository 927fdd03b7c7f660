"""Points of a key frame of the topography view in the frames that follow."""

from typing import ClassVar, NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.kernels.tracking_limits import WARP_GAUGE_PX
from fingerflow.ops.deformation import displaced, edge_shift, less_bending
from fingerflow.ops.outliers import Neighbours, Outliers, find_outliers
from fingerflow.ops.plane_fit import Support
from fingerflow.ops.point_gradients import neighbour_planes, neighbours_support
from fingerflow.ops.templates import Found, Templates, find_templates
from fingerflow.ops.tensors import finite


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
    """Learns the deformation of the skin around its points from where they were found, and corrects the positions.

    F = I + du/dX by local fits in the key frame; `ops.deformation` says what E = F F_0^-1 - I does to a template that
    was prepared with another F_0. What varies within a window beyond F displaces it as a whole: u(p + w) = u + F w +
    w'Hw / 2, and the mean of w'Hw / 2 over a square of n px, the Laplacian of u times (n^2 - 1) / 24, is taken off. At
    n = 25 it is 0.02 px where the divergence of skin changes by 2 % a mm.
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
        support = support or self.support(start)
        points = found.points
        expected, gradient = neighbour_planes(start, points - start, WARP_GAUGE_PX, support)
        _, second = neighbour_planes(start, gradient.flatten(2), WARP_GAUGE_PX, support)
        # Components before points from here on, (K, 4, N): runtimes are slow where the last axis is short.
        second = second.flatten(2).mT
        laplacian = second[:, ::4] + second[:, 3::4]
        identity = torch.eye(2, dtype=points.dtype, device=points.device).reshape(4, 1)
        warp = identity + _or_zero(gradient.flatten(2).mT.contiguous())
        unknown = multiplied(warp, inverse_warp.flatten(2).mT.contiguous()) - identity
        of = numbers.mT.contiguous()
        bulge = _or_zero(laplacian) * ((self.window**2 - 1) / 24)
        corrected = found._replace(
            points=points - (displaced(of, unknown) + bulge).mT,
            covariance=less_bending(found.covariance, of, unknown, self.window),
        )
        return Deformed(corrected, warp.mT.unflatten(2, (2, 2)), edge_shift(unknown, self.window), start + expected)


class AgreementGraph(nn.Module):
    """Points that were found but not where their neighbours say, or that are far more uncertain than they."""

    point_axes: ClassVar = {"neighbours": 2, "start": 1, "points": 1, "position_std": 1}

    def forward(self, neighbours: Neighbours, start: Tensor, points: Tensor, position_std: Tensor) -> Outliers:
        """`ops.outliers.find_neighbours` of the places (1, N, 2) in the key frame, and points (K, N, 2) and the
        standard deviation (K, N) of a component in K frames.
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


def _or_zero(values: Tensor) -> Tensor:
    """Return the values with 0 in place of those that are not finite."""
    return torch.where(finite(values), values, 0.0)


def multiplied(a: Tensor, b: Tensor) -> Tensor:
    """Products (K, 4, N) of matrices (K or 1, 4, N), by xx, xy, yx, yy."""
    rows, other = a.unflatten(1, (2, 2)), b.unflatten(1, (2, 2))
    result: Tensor = (rows[:, :, :1] * other[:, None, 0] + rows[:, :, 1:] * other[:, None, 1]).flatten(1, 2)
    return result
