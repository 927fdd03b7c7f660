"""Detection of tracked points that deviate from their neighbours, or are far more uncertain than their neighbours.

Compiled twin: `kernels/outliers.cpp`.
"""

import torch
from torch import Tensor

from fingerflow.kernels import outlier_limits as limits
from fingerflow.ops.branching import may_branch
from fingerflow.ops.tensors import finite

_LEAST = 1e-30


def find_outliers(
    neighbours: tuple[Tensor, Tensor, Tensor], displacement: Tensor, position_std: Tensor
) -> tuple[Tensor, Tensor]:
    """Flag points whose displacement or uncertainty differs greatly from that of their neighbours.

    A point i and a neighbour j agree if both lie on one plane of slope G to within their standard deviations. Their
    misfit is z^2 = |u_j - u_i - G (x_j - x_i)|^2 / (s_i^2 + s_j^2). The disagreement of a point is the square root of
    the harmonic mean of 1 + z^2 over its neighbours. The few neighbours that agree dominate this mean: half of them
    beside a slip front, a quarter at its corner, none for a wrong match. A point is flagged if its disagreement exceeds
    a multiple of its neighbours' own (their harmonic mean), so that texture common to the whole field cancels. This
    follows the normalised median test (Westerweel & Scarano 2005, Experiments in Fluids 39, 1096), which takes medians
    for both and has no slope.

    G is the best of three candidates:
    - None (G = 0).
    - The slope of a plane fitted to those neighbours that are close to the point in displacement (one step of
      reweighting). The plane need not pass through the point itself.
    - The mean of these slopes over the neighbourhood, weighted by how well each fits. Beside a front this is the slope
      of the side without the front.

    Neighbouring points that are wrong in the same way cannot be distinguished from points at a slip front.

    Args:
        neighbours: of `kernels.tracking.find_neighbours`, as tensors: indices (P, k, N), offsets (P, k, N, 2) from the
            point, and (P, k, N), 1 where a neighbour counts, else 0; for P = B, or P = 1 for all frames.
        displacement: (B, N, 2) in the unit of the positions; NaN where it is unknown.
        position_std: (B, N) standard deviation of a component.

    Returns:
        Flags (B, N) bool, of points that are off their neighbours: the displacement disagrees with every local plane
        through these; and of uncertain points, whose standard deviation is far above that of the neighbours. Both are
        False where the displacement or its deviation is unknown, or where fewer than five neighbours are known.
    """
    index, offset, within = neighbours
    # (P, k, N), broadcast over frames. Contiguous: interleaved pairs would not be vectorised.
    x, y = (part.contiguous() for part in offset.unbind(-1))
    valid = finite(displacement.sum(-1) + position_std)[:, None]  # (B, 1, N), as all quantities per point
    present = valid.to(displacement.dtype)
    sure = torch.where(valid, position_std[:, None], 1.0).clamp_min(limits.LEAST_DEVIATION)
    u, v = torch.where(valid, displacement.mT, 0.0).split(1, dim=1)
    there_u, there_v, variance, there = _gather_neighbours(index, u, v, sure.square(), present)
    weight = there * within
    number = _sum_over_neighbours(weight)
    u, v = there_u - u, there_v - v
    precision = 1 / (variance + sure.square())

    distance, level = _agreement(u, v, precision, weight, number)
    slope = _plane(x, y, u, v, weight / (1 + distance / (limits.SPREAD * level)))
    _, fitted = _agreement(*_plane_residuals(slope, x, y, u, v), precision, weight, number)
    trust = present / fitted.square()
    donated = (*(part * trust for part in slope), trust)
    *slopes, total = (
        _sum_over_neighbours(part * within) + values
        for part, values in zip(_gather_neighbours(index, *donated), donated, strict=True)
    )
    total = total.clamp_min(_LEAST)
    _, borrowed = _agreement(
        *_plane_residuals([part / total for part in slopes], x, y, u, v), precision, weight, number
    )
    disagreement = torch.minimum(torch.minimum(level, fitted), borrowed).sqrt()
    # Harmonic means of the disagreement and deviation of the neighbours: outliers among them hardly contribute.
    usual, usual_deviation = (
        number / _sum_over_neighbours(part * weight).clamp_min(_LEAST)
        for part in _gather_neighbours(index, 1 / disagreement, 1 / sure)
    )
    judged = valid & (number >= limits.LEAST_NEIGHBOURS)
    return (
        (judged & (disagreement > limits.MOST_DISAGREEMENT * usual)).squeeze(1),
        (judged & (sure > limits.MOST_UNCERTAINTY * usual_deviation)).squeeze(1),
    )


def _gather_neighbours(index: Tensor, *values: Tensor) -> tuple[Tensor, ...]:
    """Gather the values (B, k, N) of the k neighbours of each point, given point values (B, 1, N).

    The indices are (1 or B, k, N).
    """
    batch, _, points = values[0].shape
    rows, number = torch.cat(values, dim=1), index.flatten()
    if index.shape[0] != 1:
        there = rows.gather(2, index.flatten(1)[:, None].expand(-1, len(values), -1))
    elif torch.compiler.is_exporting() or not batch:  # this form of gather takes ONNX runtimes a quarter of the time
        there = rows.gather(2, number.to(torch.int32).expand(batch, len(values), -1))
    elif may_branch(rows):  # selecting from one row at a time is twice as fast
        there = torch.stack([row.index_select(0, number) for row in rows.flatten(0, 1)])
    else:
        there = rows.index_select(2, number)
    count = index.shape[1]
    return there.reshape(batch, len(values) * count, points).split(count, dim=1)


def _sum_over_neighbours(values: Tensor) -> Tensor:
    """Return the sums (B, 1, N) of values (B, k, N) over the k neighbours of each point."""
    return values.sum(1, keepdim=True)


def _agreement(u: Tensor, v: Tensor, precision: Tensor, weight: Tensor, number: Tensor) -> tuple[Tensor, Tensor]:
    """Return the squared misfits z^2 (B, k, N) between each point and its k neighbours, which are displacement
    differences u, v squared times `precision`, and the harmonic mean (B, 1, N) of 1 + z^2.

    The mean is over the neighbours, and 1 where there are none.
    """
    distance = (u * u + v * v) * precision
    agreeing = _sum_over_neighbours(weight / (1 + distance))
    return distance, torch.where(number > 0, number / agreeing.clamp_min(_LEAST), 1.0)


def _plane(x: Tensor, y: Tensor, u: Tensor, v: Tensor, weight: Tensor) -> list[Tensor]:
    """Fit a plane to the displacement differences u, v between each point and its k neighbours at offsets x, y, by
    weighted least squares; return the slopes du/dx, du/dy, dv/dx and dv/dy.

    Each slope is (B, 1, N). The data are differences u and v (B, k, N) at offsets x and y, with weights (B, k, N).
    """
    by_x, by_y = weight * x, weight * y
    total, sum_x, sum_y = (_sum_over_neighbours(part) for part in (weight, by_x, by_y))
    total = total.clamp_min(_LEAST)
    mean_x, mean_y = sum_x / total, sum_y / total
    xx = _sum_over_neighbours(by_x * x) - mean_x * sum_x
    xy = _sum_over_neighbours(by_x * y) - mean_x * sum_y
    yy = _sum_over_neighbours(by_y * y) - mean_y * sum_y
    ridge = limits.RIDGE * (xx + yy) + _LEAST
    xx, yy = xx + ridge, yy + ridge
    determinant = (xx * yy - xy * xy).clamp_min(_LEAST)
    slopes = []
    for moved in (u, v):
        rise = _sum_over_neighbours(weight * moved)
        along_x = _sum_over_neighbours(by_x * moved) - mean_x * rise
        along_y = _sum_over_neighbours(by_y * moved) - mean_y * rise
        slopes += [(yy * along_x - xy * along_y) / determinant, (xx * along_y - xy * along_x) / determinant]
    return slopes


def _plane_residuals(slope: list[Tensor], x: Tensor, y: Tensor, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
    """Return what planes of given slopes (B, 1, N) leave of the displacement differences u, v (B, k, N) between each
    point and its k neighbours at offsets x, y.
    """
    ux, uy, vx, vy = slope
    return u - ux * x - uy * y, v - vx * x - vy * y
