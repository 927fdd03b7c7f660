"""Local fits of fixed cost, for exported graphs and accelerators: `ops.fields.local_fit` as a few products of matrices.

Components stand before points, (B, 2, N): runtimes are slow where the last axis is short.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from fingerflow.kernels.field_limits import MINIMUM_POINTS, MINIMUM_SPREAD
from fingerflow.ops.looking import looks
from fingerflow.ops.tensors import components_first, finite, sum_rows

_TINY = 1e-20
_ONE = 2.0**-60  # what counts as one: less than any number that is not 0 here, so that clamping makes it of them all


class Support(NamedTuple):
    """What N points and Q queries say of fits, whatever the values; lengths in radii of the support.

    Attributes:
        weights: (1 or B, Q, N), (1 - (r/R)^2)^2 of all points at all queries, 0 beyond the radius R.
        within: (1 or B, Q, N), `_ONE` within it, else 0.
    """

    weights: Tensor
    within: Tensor


class PlaneFit(NamedTuple):
    """Planes at Q queries of B frames, of C components; lengths in radii of the support. Any number where it is not
    `known`. What does not depend on the values may be one for all frames.
    """

    known: Tensor  # (B, 1, Q) bool
    value: Tensor  # (B, C, Q), the unit of the values
    gradient: Tensor  # (B, 2 C, Q), du/dx, du/dy, dv/dx, ..., value unit per length unit
    centroid: Tensor  # (B, 2, Q), weighted mean place of the points, from the common origin
    inverse: Tensor  # (B, 3, Q), xx, xy, yy of the inverse of the points' second moments about it
    mass: Tensor  # (B, 1, Q), sum of the weights
    weights: Tensor  # of `Support`


def about_their_mean(points: Tensor, radius: float | Tensor) -> tuple[Tensor, Tensor]:
    """Places (B, 2, N) in radii from the mean of points (B, N, 2), 0 where one is not known; and (B, 1, N) whether."""
    moved = points.mT
    given = finite(sum_rows(moved))
    number = given.to(points.dtype)
    moved = torch.where(given, moved, 0.0)
    origin = moved.sum(2, keepdim=True) / number.sum(2, keepdim=True).clamp_min(1)
    return (moved - origin) * number / radius, given


def support_of(places: Tensor, queries: Tensor) -> Support:
    """Of places (1 or B, 2, N) and queries (1 or B, 2, Q) in radii from one origin, as for `fit_planes`.

    1 - |x_i - x_q|^2 is a product of (2x, |x|^2, 1) with its counterpart: no pair is visited by itself.
    """
    norm, asked_norm = sum_rows(places * places), sum_rows(queries * queries)
    support = torch.cat((2 * places, -torch.ones_like(norm), 1 - norm), dim=1)
    asked = torch.cat((queries, asked_norm, torch.ones_like(asked_norm)), dim=1)
    near = asked.mT @ support
    inside = near.clamp_min(0)
    return Support(inside * inside, inside.clamp_max(_ONE))


def fit_planes(
    places: Tensor,
    values: Tensor,
    queries: Tensor,
    usable: Tensor,
    radius: float | Tensor,
    support: Support | None = None,
) -> PlaneFit:
    """The weighted fits of `ops.local_gradients`, weights (1 - (r/R)^2)^2.

    The moments of all fits are the product of the weights with the monomials of x and u.

    Args:
        places: (1 or B, 2, N) in radii from an origin among them: digits are lost as the square of their distance.
        values: (B, C, N), any number where not usable.
        queries: (1 or B, 2, Q) in radii from the same origin.
        usable: (B, 1, N) bool; places are finite everywhere.
        radius: of the support in the length unit that gradients are to be per.
        support: of these places and queries, where it is known.
    """
    weights, within = support or support_of(places, queries)
    channels = values.shape[1]
    # Where the same points count in all frames, what is not of their values is one for all.
    if len(places) == 1 and looks(usable) and bool((usable == usable[:1]).all()):
        usable = usable[:1]
    weight = usable.to(places.dtype)
    # A plane fits as well from any height: taking off the mean keeps the digits that the slope needs.
    values = torch.where(usable, values, 0.0)
    level = values.sum(2, keepdim=True) / weight.sum(2, keepdim=True).clamp_min(1)
    moved = weight * (values - level)
    # 1, x, y, the products xx, xy, yy; and u, v, ..., ux, uy, vx, ...
    of_places = weight * torch.cat((torch.ones_like(places[:, :1]), places, squares(places)), dim=1)
    of_values = torch.cat((moved, _mixed(moved, places)), dim=1)
    count = _product(weight, within) / _ONE
    if len(of_places) == len(of_values):
        sums, moments = _product(torch.cat((of_places, of_values), dim=1), weights).split((6, 3 * channels), dim=1)
    else:
        sums, moments = _product(of_places, weights), _product(of_values, weights)
    known = count > MINIMUM_POINTS - 0.5
    mass = torch.where(known, sums[:, :1], 1.0)
    _, centroid, square = (sums / mass).split((1, 2, 3), dim=1)
    motion, mixed = (moments / mass).split((channels, 2 * channels), dim=1)
    spread, cross = square - squares(centroid), mixed - _mixed(motion, centroid)
    xx, xy, yy = spread[:, :1], spread[:, 1:2], spread[:, 2:]
    determinant = xx * yy - xy * xy
    half = (xx + yy) / 2  # of the trace
    narrowest = half - (half * half - determinant).clamp_min(0).sqrt()
    known = known & (narrowest >= MINIMUM_SPREAD**2) & (determinant > _TINY)
    inverse = torch.cat((yy, -xy, xx), dim=1) / torch.where(known, determinant, 1.0)
    by_x, by_y = cross[:, ::2], cross[:, 1::2]  # of every component
    along_x, along_y = by_x * inverse[:, :1] + by_y * inverse[:, 1:2], by_x * inverse[:, 1:2] + by_y * inverse[:, 2:]
    beside = centroid - queries
    value = motion + level - along_x * beside[:, :1] - along_y * beside[:, 1:]
    slopes = torch.stack((along_x, along_y), dim=2).flatten(1, 2)
    return PlaneFit(known, value, slopes / radius, centroid, inverse, mass, weights)


def gradient_covariance(fit: PlaneFit, places: Tensor, covariance: Tensor, radius: float) -> Tensor:
    """(B, Q, 2, 2, 2, 2) as `LocalFit` has it, from points' covariances (B, 3, N): uu, uv, vv, 0 if not usable.

    The sandwich A^-1 (sum w^2 s d d') A^-1, exact for this linear estimator and independent errors.
    """
    one = torch.ones_like(places[:, :1])
    of_places = torch.cat((one, places, squares(places)), dim=1)  # (., 6, N)
    weighted = (covariance[:, :, None] * of_places[:, None]).flatten(1, 2)
    sums = _product(weighted, fit.weights * fit.weights).unflatten(1, (3, 6)) / (fit.mass * fit.mass)[:, None]
    x, y = fit.centroid[:, None, :1], fit.centroid[:, None, 1:]
    plain, along_x, along_y, xx, xy, yy = (sums[:, :, k : k + 1] for k in range(6))
    xx = xx - 2 * x * along_x + x * x * plain
    xy = xy - x * along_y - y * along_x + x * y * plain
    yy = yy - 2 * y * along_y + y * y * plain
    a, b, d = (fit.inverse[:, None, k : k + 1] for k in range(3))
    left_xx, left_xy, left_yx, left_yy = a * xx + b * xy, a * xy + b * yy, b * xx + d * xy, b * xy + d * yy
    rows = (
        (left_xx * a + left_xy * b, left_xx * b + left_xy * d),
        (left_yx * a + left_yy * b, left_yx * b + left_yy * d),
    )
    pairs = torch.cat([number for row in rows for number in row], dim=2) / radius**2  # (B, 3, 4, Q)
    full = pairs[:, (0, 1, 1, 2)].unflatten(2, (2, 2)).unflatten(1, (2, 2))  # (B, i, k, j, l, Q)
    result: Tensor = full.permute(0, 5, 1, 3, 2, 4)
    return result


def squares(pair: Tensor) -> Tensor:
    """(B, 3, N) products aa, ab, bb of pairs (B, 2, N)."""
    return torch.cat((pair[:, :1] * pair, pair[:, 1:] * pair[:, 1:]), dim=1)


def _mixed(components: Tensor, pair: Tensor) -> Tensor:
    """(B, 2 C, N) products ac, ad, bc, ... of components (B, C, N) with pairs (1 or B, 2, N)."""
    return (components[:, :, None] * pair[:, None]).flatten(1, 2)


def _product(rows: Tensor, matrix: Tensor) -> Tensor:
    """(B, K, Q) of rows (B, K, N) and (1 or B, Q, N).

    One matrix for all frames is not copied for each of them. While a graph is exported it stands first, where runtimes
    take half the time for a product of few rows; torch takes twice as long.
    """
    if matrix.shape[0] == 1 and rows.shape[0] != 1:
        result: Tensor = _product(rows.flatten(0, 1)[None], matrix)[0].unflatten(0, rows.shape[:2])
        return result
    if rows.shape[1] == 1 or not torch.compiler.is_exporting():
        return rows @ matrix.mT
    return components_first(matrix @ rows.mT)
