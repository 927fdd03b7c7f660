"""Local plane fits by a few matrix products: the form of `ops.fields.local_fit` for exported graphs and accelerators.

Components precede points, (B, 2, N): ONNX runtimes are slow if the last axis is short.

The equations are those of `ops.fields.local_fit`, where the source and the compiled twin are stated.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from fingerflow.kernels.field_limits import MINIMUM_POINTS, MINIMUM_SPREAD
from fingerflow.ops.branching import may_branch
from fingerflow.ops.tensors import components_first, finite, products, sum_rows, symmetric

_TINY = 1e-20
# Unit of the counts of points: less than any positive value here, so that clamping makes all of these equal to it.
_ONE = 2.0**-60


# Weights of N points in the local fits around Q query positions, which depend on the distances between points and
# positions, not on the fitted values, (1 or B, Q, N) each: (1 - (r/R)^2)^2 of all points at all queries, 0 beyond the
# radius R; and `_ONE` within R, else 0.
Support = tuple[Tensor, Tensor]


class PlaneFit(NamedTuple):
    """Planes fitted to values of C components around Q query positions in each of B frames.

    Lengths are in radii of the support. Values are arbitrary where not `known`. What does not depend on the fitted
    values may have a batch of 1 for all frames.
    """

    known: Tensor  # (B, 1, Q) bool, whether the fit is determined
    value: Tensor  # (B, C, Q) fitted values, in the unit of the values
    gradient: Tensor  # (B, 2 C, Q) gradients du/dx, du/dy, dv/dx, ..., value unit per length unit
    centroid: Tensor  # (B, 2, Q) weighted mean position of the points, from the common origin
    inverse: Tensor  # (B, 3, Q) inverse of the points' second moments about the centroid, xx, xy, yy
    mass: Tensor  # (B, 1, Q) sum of the weights
    weights: Tensor  # weights of `Support`


def about_their_mean(points: Tensor, radius: float | Tensor) -> tuple[Tensor, Tensor]:
    """Return point positions (B, 2, N) relative to their mean, in units of `radius`, and a mask (B, 1, N) bool of the
    points whose positions are known (finite).

    Points are (B, N, 2). Unknown positions are 0.
    """
    moved = points.mT
    valid = finite(sum_rows(moved))
    number = valid.to(points.dtype)
    moved = torch.where(valid, moved, 0.0)
    origin = moved.sum(2, keepdim=True) / number.sum(2, keepdim=True).clamp_min(1)
    return (moved - origin) * number / radius, valid


def point_support(positions: Tensor, queries: Tensor) -> Support:
    """Compute the weights (`Support`) that points at `positions` have in local fits around positions `queries`: (1 -
    r^2)^2 at a distance r; all coordinates are in units of the fits' radius.

    Places (1 or B, 2, N) and queries (1 or B, 2, Q) are in radii of the support from one origin. 1 - |x_i - x_q|^2 is
    the product of (2x, |x|^2, 1) with its counterpart: one matrix product serves all pairs.
    """
    norm, asked_norm = sum_rows(positions * positions), sum_rows(queries * queries)
    support = torch.cat((2 * positions, -torch.ones_like(norm), 1 - norm), dim=1)
    inside = (torch.cat((queries, asked_norm, torch.ones_like(asked_norm)), dim=1).mT @ support).clamp_min(0)
    return inside * inside, inside.clamp_max(_ONE)


def fit_planes(
    positions: Tensor,
    values: Tensor,
    queries: Tensor,
    usable: Tensor,
    radius: float | Tensor,
    support: Support | None = None,
) -> PlaneFit:
    """Fit planes to point values around each query position by weighted least squares, with weights that fall to 0 at
    `radius`: the fits of `local_gradients`, by a few matrix products.

    The weights are (1 - (r/R)^2)^2 at a distance r within the radius R. The moments of all fits are the product of the
    weights with the monomials of x and u.

    Args:
        positions: (1 or B, 2, N) positions in radii from an origin among them; precision falls with the square of the
            distance.
        values: (B, C, N), arbitrary where not usable.
        queries: (1 or B, 2, Q) in radii from the same origin.
        usable: (B, 1, N) bool; `positions` are finite everywhere.
        radius: of the support, in the length unit of the gradients.
        support: of these positions and queries; computed by default.
    """
    weights, within = support or point_support(positions, queries)
    channels = values.shape[1]
    # If the same points are usable in all frames, everything but the values has a batch of 1.
    if positions.shape[0] == 1 and may_branch(usable) and bool((usable == usable[:1]).all()):
        usable = usable[:1]
    weight = usable.to(positions.dtype)
    # A constant does not change the slope; subtracting the mean preserves its precision.
    values = torch.where(usable, values, 0.0)
    level = values.sum(2, keepdim=True) / weight.sum(2, keepdim=True).clamp_min(1)
    moved = weight * (values - level)
    # Moments of the positions: 1, x, y and the products xx, xy, yy; of the values: u, v, ..., ux, uy, vx, ...
    of_places = weight * torch.cat((torch.ones_like(positions[:, :1]), positions, squares(positions)), dim=1)
    of_values = torch.cat((moved, _mixed(moved, positions)), dim=1)
    count = _product(weight, within) / _ONE
    if of_places.shape[0] == of_values.shape[0]:
        sums, moments = _product(torch.cat((of_places, of_values), dim=1), weights).split((6, 3 * channels), dim=1)
    else:
        sums, moments = _product(of_places, weights), _product(of_values, weights)
    determined = count > MINIMUM_POINTS - 0.5
    mass = torch.where(determined, sums[:, :1], 1.0)
    _, centroid, square = (sums / mass).split((1, 2, 3), dim=1)
    motion, mixed = (moments / mass).split((channels, 2 * channels), dim=1)
    spread, cross = square - squares(centroid), mixed - _mixed(motion, centroid)
    xx, xy, yy = spread[:, :1], spread[:, 1:2], spread[:, 2:]
    determinant = xx * yy - xy * xy
    half = (xx + yy) / 2  # half of the trace
    narrowest = half - (half * half - determinant).clamp_min(0).sqrt()
    determined = determined & (narrowest >= MINIMUM_SPREAD**2) & (determinant > _TINY)
    inverse = torch.cat((yy, -xy, xx), dim=1) / torch.where(determined, determinant, 1.0)
    by_x, by_y = cross[:, ::2], cross[:, 1::2]  # moments of every value with x and with y
    along_x, along_y = by_x * inverse[:, :1] + by_y * inverse[:, 1:2], by_x * inverse[:, 1:2] + by_y * inverse[:, 2:]
    offset = centroid - queries
    value = motion + level - along_x * offset[:, :1] - along_y * offset[:, 1:]
    slopes = torch.stack((along_x, along_y), dim=2).flatten(1, 2)
    return PlaneFit(determined, value, slopes / radius, centroid, inverse, mass, weights)


def gradient_covariance(fit: PlaneFit, positions: Tensor, covariance: Tensor, radius: float | Tensor) -> Tensor:
    """Return the covariance (B, Q, 2, 2, 2, 2) of the displacement gradients of fitted planes, given the covariance (B,
    3, N) of point displacements; the axes are as in `LocalFit`.

    `covariance` (B, 3, N) is that of the points: uu, uv, vv, 0 where not usable. The sandwich A^-1 (sum w^2 s d d')
    A^-1 is exact for this linear estimator and independent errors.
    """
    of_places = torch.cat((torch.ones_like(positions[:, :1]), positions, squares(positions)), dim=1)  # (., 6, N)
    weighted = (covariance[:, :, None] * of_places[:, None]).flatten(1, 2)
    sums = _product(weighted, fit.weights * fit.weights).unflatten(1, (3, 6)) / (fit.mass * fit.mass)[:, None]
    x, y = fit.centroid[:, None, :1], fit.centroid[:, None, 1:]
    plain, along_x, along_y, xx, xy, yy = (sums[:, :, k : k + 1] for k in range(6))
    xx = xx - 2 * x * along_x + x * x * plain
    xy = xy - x * along_y - y * along_x + x * y * plain
    yy = yy - 2 * y * along_y + y * y * plain
    bread, filling = symmetric(fit.inverse)[:, None], torch.cat((xx, xy, xy, yy), dim=2).unflatten(2, (2, 2))
    pairs = products(products(bread, filling), bread) / radius**2  # (B, 3, 2, 2, Q)
    full = pairs[:, (0, 1, 1, 2)].unflatten(1, (2, 2))  # (B, i, k, j, l, Q)
    return full.permute(0, 5, 1, 3, 2, 4)


def squares(pair: Tensor) -> Tensor:
    """Return the second-order products aa, ab and bb (B, 3, N) of pairs (a, b) (B, 2, N)."""
    return torch.cat((pair[:, :1] * pair, pair[:, 1:] * pair[:, 1:]), dim=1)


def _mixed(components: Tensor, pair: Tensor) -> Tensor:
    """Return the mixed products (B, 2 C, N) of components (B, C, N) with both elements of pairs (1 or B, 2, N)."""
    return (components[:, :, None] * pair[:, None]).flatten(1, 2)


def _product(rows: Tensor, matrix: Tensor) -> Tensor:
    """Sum the data of N points with weights: return the product (B, K, Q) of rows of data (B, K, N) and a matrix of
    weights (1 or B, Q, N).

    One matrix for all frames is not copied for each of them. In an exported graph the matrix is the first factor for
    2 to 12 rows: this takes ONNX runtimes less time there, but torch twice the time.
    """
    if matrix.shape[0] == 1 and rows.shape[0] != 1:
        return _product(rows.flatten(0, 1)[None], matrix)[0].unflatten(0, rows.shape[:2])
    if not 1 < rows.shape[1] < 13 or not torch.compiler.is_exporting():
        return rows @ matrix.mT
    return components_first(matrix @ rows.mT)
