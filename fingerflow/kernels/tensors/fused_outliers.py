"""Outliers among tracked points by three kernels of Triton: slopes, disagreements and flags of all points and frames.

They take the steps of `ops.tracking.outliers.find_outliers`, with its results to rounding. A program computes a block
of points with their neighbours; each kernel needs what the one before it found at the neighbours.
"""

import torch
import triton
import triton.language as tl
from torch import Tensor

from fingerflow.kernels import outlier_limits as limits
from fingerflow.kernels.tensors.fused_fits import is_finite

POINTS = 32  # of a program

_LEAST = tl.constexpr(1e-30)
_ROWS = tl.constexpr(
    7
)  # numbers of a point for its neighbours: four slopes, trust, and the disagreements on two planes
_LEAST_DEVIATION, _SPREAD = tl.constexpr(limits.LEAST_DEVIATION), tl.constexpr(limits.SPREAD)
_RIDGE, _LEAST_NEIGHBOURS = tl.constexpr(limits.RIDGE), tl.constexpr(limits.LEAST_NEIGHBOURS)
_MOST_DISAGREEMENT = tl.constexpr(limits.MOST_DISAGREEMENT)
_MOST_UNCERTAINTY = tl.constexpr(limits.MOST_UNCERTAINTY)


def find_outliers(
    number: Tensor, offset: Tensor, within: Tensor, displacement: Tensor, position_std: Tensor
) -> tuple[Tensor, Tensor]:
    """Return flags (B, N) bool of the points off their neighbours and of the uncertain ones.

    `number` (P, k, N) int64, `offset` (P, k, N, 2) and `within` (P, k, N) are those of
    `ops.tracking.outliers.Neighbours`; `displacement` is (B, N, 2), `position_std` (B, N), all float32.
    """
    (frames, neighbours, count), batch = number.shape, len(displacement)
    donated = displacement.new_empty(batch, _ROWS.value, count)
    agreement = displacement.new_empty(batch, count)
    off, uncertain = (torch.empty(batch, count, dtype=torch.bool, device=displacement.device) for _ in range(2))
    if batch and count:
        near = number.contiguous(), offset.contiguous(), within.contiguous()
        given = *near, displacement.contiguous(), position_std.contiguous()
        sizes = frames, neighbours, count
        grid = -(-count // POINTS), batch
        tile = {"POINTS": POINTS, "NEIGHBOURS": triton.next_power_of_2(neighbours)}
        _fit_slopes[grid](*given, donated, *sizes, **tile)
        _compare[grid](*given, donated, agreement, *sizes, **tile)
        _flag[grid](*given, agreement, off.view(torch.uint8), uncertain.view(torch.uint8), *sizes, **tile)
    return off, uncertain


@triton.jit
def _point(displacement, deviation, point, there):
    """Return displacements, 0 where unknown, standard deviations with a least value, and the mask of known points."""
    u = tl.load(displacement + 2 * point, mask=there, other=float("nan"))
    v = tl.load(displacement + 2 * point + 1, mask=there, other=float("nan"))
    std = tl.load(deviation + point, mask=there, other=float("nan"))
    known = is_finite(u + v + std)
    sure = tl.maximum(tl.where(known, std, 1.0), _LEAST_DEVIATION)
    return tl.where(known, u, 0.0), tl.where(known, v, 0.0), sure, known


@triton.jit
def _pairs(
    number,
    offset,
    within,
    displacement,
    deviation,
    frames,
    neighbours,
    count,
    POINTS: tl.constexpr,
    NEIGHBOURS: tl.constexpr,
):
    """Return, for a block of points (P, 1) and their neighbours (P, k): the points, the neighbours, offsets and
    differences of displacement in x and y, 1 for those within reach, their weights (known and within reach) and
    precision, the deviation of the points and whether they are known, and the deviation of the neighbours.
    """
    frame = tl.program_id(1).to(tl.int64)
    first = tl.where(frames == 1, 0, frame) * neighbours * count
    point = (tl.program_id(0) * POINTS + tl.arange(0, POINTS))[:, None]
    rank = tl.arange(0, NEIGHBOURS)[None, :]
    there = (point < count) & (rank < neighbours)
    at = first + rank * count + point
    neighbour = tl.load(number + at, mask=there, other=0)
    x = tl.load(offset + 2 * at, mask=there, other=0.0)
    y = tl.load(offset + 2 * at + 1, mask=there, other=0.0)
    near = tl.load(within + at, mask=there, other=0.0)
    displacement += frame * count * 2
    deviation += frame * count
    own_u, own_v, own_sure, own_known = _point(displacement, deviation, point, point < count)
    u, v, sure, known = _point(displacement, deviation, neighbour, there)
    weight = tl.where(known, near, 0.0)
    precision = 1 / (sure * sure + own_sure * own_sure)
    return (
        point, neighbour, there, x, y, u - own_u, v - own_v, near, weight, precision, own_sure, own_known, sure,
    )  # fmt: skip


@triton.jit
def _agreement(u, v, precision, weight, number):
    """Return the squared misfits of displacement differences, and the harmonic mean of 1 plus these."""
    distance = (u * u + v * v) * precision
    agreeing = tl.sum(weight / (1 + distance), 1)[:, None]
    return distance, tl.where(number > 0, number / tl.maximum(agreeing, _LEAST), 1.0)


@triton.jit
def _slopes(u, weight, by_x, by_y, mean_x, mean_y, xx, xy, yy, determinant):
    rise = tl.sum(weight * u, 1)[:, None]
    along_x = tl.sum(by_x * u, 1)[:, None] - mean_x * rise
    along_y = tl.sum(by_y * u, 1)[:, None] - mean_y * rise
    return (yy * along_x - xy * along_y) / determinant, (xx * along_y - xy * along_x) / determinant


@triton.jit
def _fit_slopes(
    number,
    offset,
    within,
    displacement,
    deviation,
    donated,
    frames,
    neighbours,
    count,
    POINTS: tl.constexpr,
    NEIGHBOURS: tl.constexpr,
):
    point, neighbour, there, x, y, u, v, near, weight, precision, sure, known, other_sure = _pairs(
        number, offset, within, displacement, deviation, frames, neighbours, count, POINTS, NEIGHBOURS
    )
    frame = tl.program_id(1).to(tl.int64)
    present = point < count
    total = tl.sum(weight, 1)[:, None]
    distance, level = _agreement(u, v, precision, weight, total)
    close = weight / (1 + distance / (level * _SPREAD))
    by_x = close * x
    by_y = close * y
    sum_x = tl.sum(by_x, 1)[:, None]
    sum_y = tl.sum(by_y, 1)[:, None]
    mass = tl.maximum(tl.sum(close, 1)[:, None], _LEAST)
    mean_x = sum_x / mass
    mean_y = sum_y / mass
    xx = tl.sum(by_x * x, 1)[:, None] - mean_x * sum_x
    xy = tl.sum(by_x * y, 1)[:, None] - mean_x * sum_y
    yy = tl.sum(by_y * y, 1)[:, None] - mean_y * sum_y
    ridge = (xx + yy) * _RIDGE + _LEAST
    xx += ridge
    yy += ridge
    determinant = tl.maximum(xx * yy - xy * xy, _LEAST)
    ux, uy = _slopes(u, close, by_x, by_y, mean_x, mean_y, xx, xy, yy, determinant)
    vx, vy = _slopes(v, close, by_x, by_y, mean_x, mean_y, xx, xy, yy, determinant)
    distance, fitted = _agreement(u - ux * x - uy * y, v - vx * x - vy * y, precision, weight, total)
    trust = tl.where(known, 1 / (fitted * fitted), 0.0)
    to = donated + frame * _ROWS * count + point
    tl.store(to, ux * trust, mask=present)
    tl.store(to + count, uy * trust, mask=present)
    tl.store(to + 2 * count, vx * trust, mask=present)
    tl.store(to + 3 * count, vy * trust, mask=present)
    tl.store(to + 4 * count, trust, mask=present)
    tl.store(to + 5 * count, level, mask=present)
    tl.store(to + 6 * count, fitted, mask=present)


@triton.jit
def _mean_around(donated, point, neighbour, there, near, count):
    """Return the sum of a donated number over the neighbours within reach and the point itself."""
    of_others = tl.load(donated + neighbour, mask=there, other=0.0)
    return tl.sum(of_others * near, 1)[:, None] + tl.load(donated + point, mask=point < count, other=0.0)


@triton.jit
def _compare(
    number,
    offset,
    within,
    displacement,
    deviation,
    donated,
    agreement,
    frames,
    neighbours,
    count,
    POINTS: tl.constexpr,
    NEIGHBOURS: tl.constexpr,
):
    point, neighbour, there, x, y, u, v, near, weight, precision, sure, known, other_sure = _pairs(
        number, offset, within, displacement, deviation, frames, neighbours, count, POINTS, NEIGHBOURS
    )
    frame = tl.program_id(1).to(tl.int64)
    present = point < count
    own = donated + frame * _ROWS * count
    trust = tl.maximum(_mean_around(own + 4 * count, point, neighbour, there, near, count), _LEAST)
    ux = _mean_around(own, point, neighbour, there, near, count) / trust
    uy = _mean_around(own + count, point, neighbour, there, near, count) / trust
    vx = _mean_around(own + 2 * count, point, neighbour, there, near, count) / trust
    vy = _mean_around(own + 3 * count, point, neighbour, there, near, count) / trust
    total = tl.sum(weight, 1)[:, None]
    distance, borrowed = _agreement(u - ux * x - uy * y, v - vx * x - vy * y, precision, weight, total)
    level = tl.load(own + 5 * count + point, mask=present, other=1.0)
    fitted = tl.load(own + 6 * count + point, mask=present, other=1.0)
    disagreement = tl.sqrt(tl.minimum(tl.minimum(level, fitted), borrowed))
    tl.store(agreement + frame * count + point, 1 / disagreement, mask=present)


@triton.jit
def _flag(
    number,
    offset,
    within,
    displacement,
    deviation,
    agreement,
    off,
    uncertain,
    frames,
    neighbours,
    count,
    POINTS: tl.constexpr,
    NEIGHBOURS: tl.constexpr,
):
    point, neighbour, there, x, y, u, v, near, weight, precision, sure, known, other_sure = _pairs(
        number, offset, within, displacement, deviation, frames, neighbours, count, POINTS, NEIGHBOURS
    )
    frame = tl.program_id(1).to(tl.int64)
    present = point < count
    agreement += frame * count
    total = tl.sum(weight, 1)[:, None]
    # Harmonic means: outliers among the neighbours hardly contribute.
    of_others = tl.load(agreement + neighbour, mask=there, other=0.0)
    usual = total / tl.maximum(tl.sum(of_others * weight, 1)[:, None], _LEAST)
    usual_deviation = total / tl.maximum(tl.sum(weight / other_sure, 1)[:, None], _LEAST)
    judged = known & (total >= _LEAST_NEIGHBOURS)
    disagreement = 1 / tl.load(agreement + point, mask=present, other=1.0)
    is_off = judged & (disagreement > usual * _MOST_DISAGREEMENT)
    is_uncertain = judged & (sure > usual_deviation * _MOST_UNCERTAINTY)
    tl.store(off + frame * count + point, tl.where(is_off, 1, 0).to(tl.uint8), mask=present)
    tl.store(uncertain + frame * count + point, tl.where(is_uncertain, 1, 0).to(tl.uint8), mask=present)
