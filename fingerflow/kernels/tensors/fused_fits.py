"""Local plane fits to scattered points by one kernel of Triton: one launch for all queries and frames.

A program fits one component of the values at a block of queries. It visits all points, with the differences from the
queries, and takes the sums of `ops.fields.local_fit`, with its results to rounding.
"""

import math

import torch
import triton
import triton.language as tl
from torch import Tensor

from fingerflow.kernels.fields import FittedPlanes

QUERIES, POINTS = 16, 32  # queries of a program, and points that it visits at a time

_INF = tl.constexpr(math.inf)


def local_gradients(
    points: Tensor,
    values: Tensor,
    queries: Tensor,
    noise: Tensor | None,
    *,
    radius: float,
    least_spread: float,
    minimum_points: int,
) -> FittedPlanes[Tensor]:
    """Fit planes to the values of scattered points around query positions, as `kernels.fields.local_gradients`; all
    tensors are float32.
    """
    batch = max(len(one) for one in (points, values, queries))
    (count, components), total = values.shape[1:], queries.shape[1]
    noises = 0 if noise is None else noise.shape[2]
    value, gradient = values.new_empty(batch, total, components), values.new_empty(batch, total, components, 2)
    covariance = None if noise is None else values.new_empty(batch, total, components, 2, components, 2)
    offset, number = values.new_empty(batch, total), values.new_empty(batch, total, dtype=torch.int64)
    if batch and total:
        _fit[(-(-total // QUERIES), batch * components)](
            *(one.contiguous() for one in (points, values, queries, values if noise is None else noise)),
            *(value, gradient, value if covariance is None else covariance, number, offset),
            *(count, total, len(points), len(values), len(queries), 1 if noise is None else len(noise)),
            *(radius, least_spread, minimum_points),
            COMPONENTS=components,
            NOISES=noises,
            QUERIES=QUERIES,
            POINTS=POINTS,
        )
    return FittedPlanes(value, gradient, covariance, number, offset)


@triton.jit
def is_finite(value):
    """Return a mask of the finite values."""
    return tl.abs(value) < _INF


@triton.jit
def weights_between(x, y, at_x, at_y, usable, radius):
    """Return the differences (Q, P) in x and y from queries (Q, 1) to points (1, P), the weights (1 - (r/R)^2)^2 of
    the usable points within the radius R, and 1 for these points, else 0.
    """
    across = x - at_x
    down = y - at_y
    squared = across * across + down * down
    near = tl.maximum(1.0 - squared / (radius * radius), 0.0)
    return across, down, tl.where(usable, near * near, 0.0), tl.where(usable & (squared < radius * radius), 1.0, 0.0)


@triton.jit
def point_at(positions, values, noise, point, count, COMPONENTS: tl.constexpr, NOISES: tl.constexpr):
    """Return the positions x and y of points, 0 where they are unknown, and a mask of the usable points: position,
    values and noise are finite, and no variance is negative.
    """
    there = point < count
    x = tl.load(positions + 2 * point, mask=there, other=float("nan"))
    y = tl.load(positions + 2 * point + 1, mask=there, other=float("nan"))
    usable = is_finite(x) & is_finite(y)
    for one in tl.static_range(COMPONENTS):
        usable = usable & is_finite(tl.load(values + COMPONENTS * point + one, mask=there, other=float("nan")))
    for one in tl.static_range(NOISES):
        variance = tl.load(noise + NOISES * point + one, mask=there, other=float("nan"))
        usable = usable & is_finite(variance)
        if one % (COMPONENTS + 1) == 0:
            usable = usable & (variance >= 0)
    return tl.where(usable, x, 0.0), tl.where(usable, y, 0.0), usable


@triton.jit
def _fit(
    positions,
    values,
    queries,
    noise,
    value,
    gradient,
    covariance,
    number,
    offset,
    count,
    total,
    positions_batch,
    values_batch,
    queries_batch,
    noise_batch,
    radius,
    least_spread,
    minimum_points,
    COMPONENTS: tl.constexpr,
    NOISES: tl.constexpr,
    QUERIES: tl.constexpr,
    POINTS: tl.constexpr,
):
    frame = (tl.program_id(1) // COMPONENTS).to(tl.int64)
    own = tl.program_id(1) % COMPONENTS
    positions += tl.where(positions_batch == 1, 0, frame) * count * 2
    values += tl.where(values_batch == 1, 0, frame) * count * COMPONENTS
    noise += tl.where(noise_batch == 1, 0, frame) * count * NOISES
    queries += tl.where(queries_batch == 1, 0, frame) * total * 2
    query = (tl.program_id(0) * QUERIES + tl.arange(0, QUERIES))[:, None]
    there = query < total
    at_x = tl.load(queries + 2 * query, mask=there, other=float("nan"))
    at_y = tl.load(queries + 2 * query + 1, mask=there, other=float("nan"))
    asked = is_finite(at_x) & is_finite(at_y)
    at_x = tl.where(asked, at_x, 0.0)
    at_y = tl.where(asked, at_y, 0.0)
    step = tl.arange(0, POINTS)[None, :]
    # A constant does not change the slope: subtracting the mean saves its precision.
    sums = tl.zeros((1, POINTS), tl.float32)
    known = tl.zeros((1, POINTS), tl.float32)
    for first in range(0, count, POINTS):
        _, _, usable = point_at(positions, values, noise, first + step, count, COMPONENTS, NOISES)
        of_point = tl.load(values + COMPONENTS * (first + step) + own, mask=usable, other=0.0)
        sums += of_point
        known += tl.where(usable, 1.0, 0.0)
    level = tl.sum(sums) / tl.maximum(tl.sum(known), 1.0)

    near = tl.zeros((QUERIES, POINTS), tl.float32)
    mass = tl.zeros((QUERIES, POINTS), tl.float32)
    mass_x = tl.zeros((QUERIES, POINTS), tl.float32)
    mass_y = tl.zeros((QUERIES, POINTS), tl.float32)
    mass_xx = tl.zeros((QUERIES, POINTS), tl.float32)
    mass_xy = tl.zeros((QUERIES, POINTS), tl.float32)
    mass_yy = tl.zeros((QUERIES, POINTS), tl.float32)
    data = tl.zeros((QUERIES, POINTS), tl.float32)
    data_x = tl.zeros((QUERIES, POINTS), tl.float32)
    data_y = tl.zeros((QUERIES, POINTS), tl.float32)
    for first in range(0, count, POINTS):
        x, y, usable = point_at(positions, values, noise, first + step, count, COMPONENTS, NOISES)
        of_point = tl.load(values + COMPONENTS * (first + step) + own, mask=usable, other=0.0)
        of_point = tl.where(usable, of_point - level, 0.0)
        across, down, weight, within = weights_between(x, y, at_x, at_y, usable, radius)
        by_x = weight * across
        by_y = weight * down
        near += within
        mass += weight
        mass_x += by_x
        mass_y += by_y
        mass_xx += by_x * across
        mass_xy += by_x * down
        mass_yy += by_y * down
        data += weight * of_point
        data_x += by_x * of_point
        data_y += by_y * of_point

    found = tl.where(asked, tl.sum(near, 1)[:, None], 0.0)
    determined = found >= minimum_points
    total_mass = tl.where(determined, tl.sum(mass, 1)[:, None], 1.0)
    center_x = tl.sum(mass_x, 1)[:, None] / total_mass
    center_y = tl.sum(mass_y, 1)[:, None] / total_mass
    xx = tl.sum(mass_xx, 1)[:, None] / total_mass - center_x * center_x
    xy = tl.sum(mass_xy, 1)[:, None] / total_mass - center_x * center_y
    yy = tl.sum(mass_yy, 1)[:, None] / total_mass - center_y * center_y
    half = (xx - yy) / 2
    narrowest = (xx + yy) / 2 - tl.sqrt(half * half + xy * xy)  # the smaller eigenvalue
    determined = determined & (narrowest >= least_spread * least_spread)
    determinant = tl.where(determined, xx * yy - xy * xy, 1.0)
    inverse_xx = yy / determinant
    inverse_xy = -xy / determinant
    inverse_yy = xx / determinant
    mean = tl.sum(data, 1)[:, None] / total_mass
    moment_x = tl.sum(data_x, 1)[:, None] / total_mass - mean * center_x
    moment_y = tl.sum(data_y, 1)[:, None] / total_mass - mean * center_y
    along_x = moment_x * inverse_xx + moment_y * inverse_xy
    along_y = moment_x * inverse_xy + moment_y * inverse_yy
    unknown = tl.where(determined, 0.0, float("nan"))
    to = frame * total + query
    tl.store(
        value + COMPONENTS * to + own, mean - along_x * center_x - along_y * center_y + level + unknown, mask=there
    )
    tl.store(gradient + 2 * (COMPONENTS * to + own), along_x + unknown, mask=there)
    tl.store(gradient + 2 * (COMPONENTS * to + own) + 1, along_y + unknown, mask=there)
    first_component = query < tl.where(own == 0, total, 0)
    tl.store(number + to, found.to(tl.int64), mask=first_component)
    tl.store(offset + to, tl.sqrt(center_x * center_x + center_y * center_y) + unknown, mask=first_component)

    # The covariance A^-1 (sum w^2 s d d') A^-1 with each component, which is 0 if one variance serves all of them.
    for other in tl.static_range(COMPONENTS if NOISES > 0 else 0):
        spread_xx = tl.zeros((QUERIES, POINTS), tl.float32)
        spread_xy = tl.zeros((QUERIES, POINTS), tl.float32)
        spread_yy = tl.zeros((QUERIES, POINTS), tl.float32)
        for first in range(0, count, POINTS):
            point = first + step
            x, y, usable = point_at(positions, values, noise, point, count, COMPONENTS, NOISES)
            between = own * COMPONENTS + other if NOISES > 1 else 0
            variance = tl.load(noise + NOISES * point + between, mask=usable, other=0.0)
            if NOISES == 1:
                variance = tl.where(own == other, variance, 0.0)
            across, down, weight, _ = weights_between(x, y, at_x, at_y, usable, radius)
            across -= center_x
            down -= center_y
            strength = weight * weight * variance
            spread_xx += strength * across * across
            spread_xy += strength * across * down
            spread_yy += strength * down * down
        squared = total_mass * total_mass
        xx = tl.sum(spread_xx, 1)[:, None] / squared
        xy = tl.sum(spread_xy, 1)[:, None] / squared
        yy = tl.sum(spread_yy, 1)[:, None] / squared
        left_xx = inverse_xx * xx + inverse_xy * xy
        left_xy = inverse_xx * xy + inverse_xy * yy
        left_yx = inverse_xy * xx + inverse_yy * xy
        left_yy = inverse_xy * xy + inverse_yy * yy
        # (query, own, 2, other, 2)
        row = covariance + ((COMPONENTS * to + own) * 2 * COMPONENTS + other) * 2
        tl.store(row, left_xx * inverse_xx + left_xy * inverse_xy + unknown, mask=there)
        tl.store(row + 1, left_xx * inverse_xy + left_xy * inverse_yy + unknown, mask=there)
        tl.store(row + 2 * COMPONENTS, left_yx * inverse_xx + left_yy * inverse_xy + unknown, mask=there)
        tl.store(row + 2 * COMPONENTS + 1, left_yx * inverse_xy + left_yy * inverse_yy + unknown, mask=there)
