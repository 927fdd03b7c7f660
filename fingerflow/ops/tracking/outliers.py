"""Which tracked points are off what their neighbours say, and which are far more uncertain than they."""

from typing import NamedTuple

import torch
from torch import Tensor

from fingerflow.kernels import outlier_limits as limits
from fingerflow.ops.looking import looks
from fingerflow.ops.tensors import finite

_LEAST = 1e-30


class Neighbours(NamedTuple):
    """The k nearest neighbours of N points, nearest first: numbers (P, k, N), offsets (P, k, N, 2), and whether they
    lie within the gauge length and are known, (P, k, N) of 0 and 1.
    """

    number: Tensor
    offset: Tensor
    within: Tensor


class Outliers(NamedTuple):
    """(B, N) bool each; neither where a displacement is unknown or has fewer than five neighbours that are known.

    Attributes:
        off_neighbours: the displacement is not what any local plane through its neighbours allows.
        uncertain: the standard deviation is far above that of the neighbours.
    """

    off_neighbours: Tensor
    uncertain: Tensor


def find_neighbours(positions: Tensor, gauge_length: float) -> Neighbours:
    """The points to judge each point by, once for all frames of the same points.

    Args:
        positions: (P, N, 2) of reference, NaN where there is none. N is 2 or more.
        gauge_length: diameter around a point in which neighbours count, in the unit of the positions.
    """
    if positions.shape[1] < 2:
        raise ValueError(f"{positions.shape[1]} points have no neighbours: give 2 or more")
    # Components by themselves, and the nearest along rows, as distances are the same both ways: half the time.
    across, down = (one[:, None] - one[:, :, None] for one in positions.unbind(-1))
    distance = across * across + down * down
    apart = ~torch.eye(positions.shape[1], dtype=torch.bool, device=positions.device)
    distance = torch.where(apart & (distance <= (gauge_length / 2) ** 2), distance, torch.inf)  # NaN is nowhere near
    nearest = distance.topk(min(limits.NEIGHBOURS, positions.shape[1] - 1), dim=2, largest=False)
    number, within = nearest.indices.mT.contiguous(), nearest.values.mT.contiguous() < torch.inf
    there = positions.gather(1, number.flatten(1)[..., None].expand(-1, -1, 2)).unflatten(1, number.shape[1:])
    offset = (there - positions[:, None]).contiguous()
    return Neighbours(number, torch.where(within[..., None], offset, 0.0), within.to(positions.dtype))


def find_outliers(neighbours: Neighbours, displacement: Tensor, position_std: Tensor) -> Outliers:
    """Points whose displacement or uncertainty stands out among their neighbours.

    A neighbour agrees with a point where both lie on one plane of slope G to within their standard deviations: it
    leaves z^2 = |u_j - u_i - G (x_j - x_i)|^2 / (s_i^2 + s_j^2). The disagreement of a point is the harmonic mean of
    1 + z^2 over its neighbours, which the few that agree decide: of a point beside a slip front half do, at a corner of
    one a quarter, and of a wrong match none. It is compared with the neighbours' own, so that what the texture of a
    field adds to all counts for nothing: the idea of the normalised median test (Westerweel & Scarano 2005,
    Experiments in Fluids 39, 1096), which takes medians for both and knows no slope.

    G is tried in three ways, and the best counts: none; the slope of a plane through those neighbours that are close to
    the point (one step of reweighting, and not through the point itself); and the mean of these slopes over the
    neighbourhood, by how well each fits, which beside a front is that of the side without it.

    A point that agrees with a neighbour, because both are wrong alike, is not told from one at a front.

    Args:
        neighbours: from :func:`find_neighbours`, for P = B, or P = 1 for all frames.
        displacement: (B, N, 2) in the unit of the positions; NaN where it is unknown.
        position_std: (B, N) standard deviation of a component.
    """
    index, offset, within = neighbours
    # (P, k, N), broadcast over frames; each by itself in memory: pairs side by side are gone through one by one.
    x, y = (part.contiguous() for part in offset.unbind(-1))
    known = finite(displacement.sum(-1) + position_std)[:, None]  # (B, 1, N), as all that is of points
    one = known.to(displacement.dtype)
    sure = torch.where(known, position_std[:, None], 1.0).clamp_min(limits.LEAST_DEVIATION)
    u, v = torch.where(known, displacement.mT, 0.0).split(1, dim=1)
    there_u, there_v, variance, there = _of_neighbours(index, u, v, sure.square(), one)
    weight = there * within
    number = _total(weight)
    u, v = there_u - u, there_v - v
    precision = 1 / (variance + sure.square())

    distance, level = _agreement(u, v, precision, weight, number)
    slope = _plane(x, y, u, v, weight / (1 + distance / (limits.SPREAD * level)))
    _, fitted = _agreement(*_above(slope, x, y, u, v), precision, weight, number)
    trust = one / fitted.square()
    donated = (*(part * trust for part in slope), trust)
    *slopes, total = (
        _total(part * within) + own for part, own in zip(_of_neighbours(index, *donated), donated, strict=True)
    )
    total = total.clamp_min(_LEAST)
    _, borrowed = _agreement(*_above([part / total for part in slopes], x, y, u, v), precision, weight, number)
    disagreement = torch.minimum(torch.minimum(level, fitted), borrowed).sqrt()
    # Harmonic means over the neighbours of their disagreement and deviation: the outliers among them hardly count.
    usual, usual_deviation = (
        number / _total(part * weight).clamp_min(_LEAST) for part in _of_neighbours(index, 1 / disagreement, 1 / sure)
    )
    judged = known & (number >= limits.LEAST_NEIGHBOURS)
    return Outliers(
        (judged & (disagreement > limits.MOST_DISAGREEMENT * usual)).squeeze(1),
        (judged & (sure > limits.MOST_UNCERTAINTY * usual_deviation)).squeeze(1),
    )


def _of_neighbours(index: Tensor, *values: Tensor) -> tuple[Tensor, ...]:
    """Values (B, 1, N) each of the neighbours, (B, k, N) each, by numbers (1 or B, k, N)."""
    batch, _, points = values[0].shape
    if index.shape[0] != 1:
        return tuple(one[:, 0].gather(1, index.flatten(1)).unflatten(1, index.shape[1:]) for one in values)
    rows, number = torch.cat(values, dim=1), index.flatten()
    if torch.compiler.is_exporting() or not batch:  # runtimes of ONNX take single numbers so in a quarter of the time
        there = rows.gather(2, number.to(torch.int32).expand(batch, len(values), -1))
    elif looks(rows):  # numbers of one row at a time are taken twice as fast
        there = torch.stack([row.index_select(0, number) for row in rows.flatten(0, 1)])
    else:
        there = rows.index_select(2, number)
    count = index.shape[1]
    result: tuple[Tensor, ...] = there.reshape(batch, len(values) * count, points).split(count, dim=1)
    return result


def _total(values: Tensor) -> Tensor:
    """Return the sums (B, 1, N) of values (B, k, N) over the k neighbours."""
    return values.sum(1, keepdim=True)


def _agreement(u: Tensor, v: Tensor, precision: Tensor, weight: Tensor, number: Tensor) -> tuple[Tensor, Tensor]:
    """z^2 (B, k, N) of differences, and the harmonic mean (B, 1, N) of 1 + z^2 over the neighbours, 1 without any."""
    distance = (u * u + v * v) * precision
    agreeing = _total(weight / (1 + distance))
    return distance, torch.where(number > 0, number / agreeing.clamp_min(_LEAST), 1.0)


def _plane(x: Tensor, y: Tensor, u: Tensor, v: Tensor, weight: Tensor) -> list[Tensor]:
    """Slopes (B, 1, N) du/dx, du/dy, dv/dx, dv/dy of the planes through differences (B, k, N) at offsets x and y, by
    least squares with weights (B, k, N).
    """
    by_x, by_y = weight * x, weight * y
    total, sum_x, sum_y = (_total(part) for part in (weight, by_x, by_y))
    total = total.clamp_min(_LEAST)
    mean_x, mean_y = sum_x / total, sum_y / total
    xx = _total(by_x * x) - mean_x * sum_x
    xy = _total(by_x * y) - mean_x * sum_y
    yy = _total(by_y * y) - mean_y * sum_y
    ridge = limits.RIDGE * (xx + yy) + _LEAST
    xx, yy = xx + ridge, yy + ridge
    determinant = (xx * yy - xy * xy).clamp_min(_LEAST)
    slopes = []
    for moved in (u, v):
        rise = _total(weight * moved)
        along_x = _total(by_x * moved) - mean_x * rise
        along_y = _total(by_y * moved) - mean_y * rise
        slopes += [(yy * along_x - xy * along_y) / determinant, (xx * along_y - xy * along_x) / determinant]
    return slopes


def _above(slope: list[Tensor], x: Tensor, y: Tensor, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
    """What differences (B, k, N) leave above planes of slopes (B, 1, N)."""
    ux, uy, vx, vy = slope
    return u - ux * x - uy * y, v - vx * x - vy * y
