"""Medians of fields over the contact by three kernels of Triton: fits at positions in the ellipse, medians, errors.

They take the steps of `ops.fields.area_medians`, with its results to rounding. Lengths are in radii of the fits, from
the centre of the ellipse. A program of the first kernel fits the fields at a block of positions, one of the second
takes the medians of a frame, and one of the third sums what a block of points contributes to the error of a median.
"""

import functools

import torch
import triton
import triton.language as tl
from torch import Tensor

from fingerflow.kernels import field_limits as limits
from fingerflow.kernels.tensors.fused_fits import is_finite
from fingerflow.kernels.tensors.fused_ranks import value_of_rank

QUERIES, POINTS = 16, 32  # positions of a program, and points that it visits at a time

_FIELDS = tl.constexpr(5)
_ROWS = tl.constexpr(22)  # numbers of a position, in the order in which `_fit_positions` stores them
_KNOWN, _GRADIENT, _INVERSE, _MASS = tl.constexpr(5), tl.constexpr(6), tl.constexpr(10), tl.constexpr(13)
_CENTROID, _APART, _STD = tl.constexpr(14), tl.constexpr(16), tl.constexpr(17)
_COLUMNS = tl.constexpr(6)  # numbers of a field at a position, with which a point's displacement changes its mean
_TINY = tl.constexpr(1e-30)
_MINIMUM_POINTS, _MINIMUM_SPREAD = tl.constexpr(limits.MINIMUM_POINTS), tl.constexpr(limits.MINIMUM_SPREAD)
_FARTHEST, _LEAST_RATIO = tl.constexpr(2 * limits.FARTHEST_CENTROID), tl.constexpr(limits.LEAST_RATIO)
_LEAST_SHARE, _REACH, _EVEN = tl.constexpr(limits.LEAST_SHARE), tl.constexpr(limits.REACH), tl.constexpr(limits.EVEN)
_SAME_PLACE = tl.constexpr((1 - limits.SAME_PLACE**2) ** 2)  # weight at that distance


def area_medians(
    reference: Tensor,
    displacement: Tensor,
    ellipses: Tensor,
    covariance: Tensor | None,
    apart: Tensor | None,
    apart_fields: Tensor | None,
    apart_std: Tensor | None,
    *,
    measure: int,
    radius: float,
) -> tuple[Tensor, Tensor | None, Tensor]:
    """Compute the medians of divergence, curl and the strains over contact ellipses, as `kernels.fields.area_medians`;
    all floating tensors are float32.
    """
    (batch, count, _), total = displacement.shape, limits.POSITIONS
    lattice = _lattice(displacement.device)
    # `reference` stands for what is absent, and is not read.
    among = None if apart is None else apart.view(torch.uint8)
    given = reference, displacement, ellipses, covariance, among, apart_fields, apart_std
    points = [(reference if one is None else one).contiguous() for one in given]
    positions = displacement.new_empty(batch, _ROWS.value, total)
    numbers = displacement.new_empty(batch, 2 * _FIELDS.value + 1)
    columns = displacement.new_empty(batch, _FIELDS.value, _COLUMNS.value, total)
    blocks = -(-count // QUERIES)
    variance = displacement.new_empty(batch, _FIELDS.value, blocks)
    own = {"NOISE": covariance is not None, "APART": apart is not None, "MEASURE": measure}
    sizes = count, total, len(reference), radius
    if batch:
        tiles = {"QUERIES": QUERIES, "POINTS": POINTS}
        _fit_positions[(-(-total // QUERIES), batch)](lattice, *points, positions, *sizes, **own, **tiles)
        tile = {"POSITIONS": triton.next_power_of_2(total), "num_warps": 8}
        _take_medians[(batch,)](*points[:5], positions, numbers, columns, *sizes, **own, **tile)
    median, joint, known = numbers.split((_FIELDS.value, _FIELDS.value, 1), dim=1)
    if covariance is None:
        return median, None, known.squeeze(1)
    if batch and count:
        grid = blocks, _FIELDS.value, batch
        _sum_errors[grid](lattice, *points[:5], columns, variance, *sizes, **own, **tiles)
    # The joint errors of a median that is not known are NaN.
    return median, (variance.sum(2) + joint * joint).clamp_min(0).sqrt(), known.squeeze(1)


@functools.cache
def _lattice(device: torch.device) -> Tensor:
    return torch.from_numpy(limits.lattice()).to(device, torch.float32)


@triton.jit
def _ellipse(ellipses, frame):
    """Return centre, semi-axes, cosine and sine of an ellipse, and whether they are those of one; else axes are 0."""
    own = ellipses + 6 * frame
    x = tl.load(own)
    y = tl.load(own + 1)
    major = tl.load(own + 2)
    minor = tl.load(own + 3)
    cosine = tl.load(own + 4)
    sine = tl.load(own + 5)
    good = is_finite(x) & is_finite(y) & is_finite(major) & is_finite(minor) & is_finite(cosine) & is_finite(sine)
    good = good & (major > 0) & (minor > 0)
    return (
        tl.where(good, x, 0.0),
        tl.where(good, y, 0.0),
        tl.where(good, major, 0.0),
        tl.where(good, minor, 0.0),
        tl.where(good, cosine, 1.0),
        tl.where(good, sine, 0.0),
        good,
    )


@triton.jit
def _positions_at(lattice, query, there, major, minor, cosine, sine, radius):
    """Return x and y of positions in an ellipse, in radii from its centre."""
    along = major / radius * tl.load(lattice + 2 * query, mask=there, other=0.0)
    across = minor / radius * tl.load(lattice + 2 * query + 1, mask=there, other=0.0)
    return along * cosine - across * sine, along * sine + across * cosine


@triton.jit
def _points_at(
    reference, displacement, covariance, apart, x, y, point, count, radius, NOISE: tl.constexpr, APART: tl.constexpr
):
    """Return x and y of points in radii from the centre of the ellipse, 0 where they are unknown, the masks of known
    and of usable points, and their displacements.
    """
    there = point < count
    u = tl.load(displacement + 2 * point, mask=there, other=float("nan"))
    v = tl.load(displacement + 2 * point + 1, mask=there, other=float("nan"))
    at_x = tl.load(reference + 2 * point, mask=there, other=float("nan")) + u
    at_y = tl.load(reference + 2 * point + 1, mask=there, other=float("nan")) + v
    known = is_finite(at_x) & is_finite(at_y)
    usable = known
    if NOISE:
        xx = tl.load(covariance + 4 * point, mask=there, other=float("nan"))
        xy = tl.load(covariance + 4 * point + 1, mask=there, other=float("nan"))
        yy = tl.load(covariance + 4 * point + 3, mask=there, other=float("nan"))
        usable = usable & is_finite(xx) & is_finite(xy) & is_finite(yy) & (xx >= 0) & (yy >= 0)
    if APART:
        usable = usable & (tl.load(apart + point, mask=there, other=0) == 0)
    at_x = tl.where(known, (at_x - x) / radius, 0.0)
    at_y = tl.where(known, (at_y - y) / radius, 0.0)
    return at_x, at_y, known, usable, tl.where(usable, u, 0.0), tl.where(usable, v, 0.0)


@triton.jit
def _weight(x, y, at_x, at_y):
    across = x - at_x
    down = y - at_y
    near = tl.maximum(1.0 - across * across - down * down, 0.0)
    return across, down, near * near, near


@triton.jit
def _fit_positions(
    lattice,
    reference,
    displacement,
    ellipses,
    covariance,
    apart,
    apart_fields,
    apart_std,
    positions,
    count,
    total,
    references,
    radius,
    NOISE: tl.constexpr,
    APART: tl.constexpr,
    MEASURE: tl.constexpr,
    QUERIES: tl.constexpr,
    POINTS: tl.constexpr,
):
    frame = tl.program_id(1).to(tl.int64)
    reference += tl.where(references == 1, 0, frame) * count * 2
    displacement += frame * count * 2
    covariance += frame * count * 4
    apart += frame * count
    apart_fields += frame * count * _FIELDS
    apart_std += frame * count * _FIELDS
    middle_x, middle_y, major, minor, cosine, sine, good = _ellipse(ellipses, frame)
    query = (tl.program_id(0) * QUERIES + tl.arange(0, QUERIES))[:, None]
    there = query < total
    x, y = _positions_at(lattice, query, there, major, minor, cosine, sine, radius)
    step = tl.arange(0, POINTS)[None, :]
    # A constant does not change the slope: subtracting the mean saves its precision.
    sum_u = tl.zeros((1, POINTS), tl.float32)
    sum_v = tl.zeros((1, POINTS), tl.float32)
    number = tl.zeros((1, POINTS), tl.float32)
    for first in range(0, count, POINTS):
        at_x, at_y, known, usable, u, v = _points_at(
            reference, displacement, covariance, apart, middle_x, middle_y, first + step, count, radius, NOISE, APART
        )
        sum_u += u
        sum_v += v
        number += tl.where(usable, 1.0, 0.0)
    level_u = tl.sum(sum_u) / tl.maximum(tl.sum(number), 1.0)
    level_v = tl.sum(sum_v) / tl.maximum(tl.sum(number), 1.0)

    within = tl.zeros((QUERIES, POINTS), tl.float32)
    mass = tl.zeros((QUERIES, POINTS), tl.float32)
    mass_x = tl.zeros((QUERIES, POINTS), tl.float32)
    mass_y = tl.zeros((QUERIES, POINTS), tl.float32)
    mass_xx = tl.zeros((QUERIES, POINTS), tl.float32)
    mass_xy = tl.zeros((QUERIES, POINTS), tl.float32)
    mass_yy = tl.zeros((QUERIES, POINTS), tl.float32)
    data_u = tl.zeros((QUERIES, POINTS), tl.float32)
    data_ux = tl.zeros((QUERIES, POINTS), tl.float32)
    data_uy = tl.zeros((QUERIES, POINTS), tl.float32)
    data_v = tl.zeros((QUERIES, POINTS), tl.float32)
    data_vx = tl.zeros((QUERIES, POINTS), tl.float32)
    data_vy = tl.zeros((QUERIES, POINTS), tl.float32)
    nearest = tl.zeros((QUERIES, POINTS), tl.float32)
    nearest_apart = tl.zeros((QUERIES, POINTS), tl.float32)
    which = tl.zeros((QUERIES, POINTS), tl.int32)
    for first in range(0, count, POINTS):
        point = first + step
        at_x, at_y, known, usable, u, v = _points_at(
            reference, displacement, covariance, apart, middle_x, middle_y, point, count, radius, NOISE, APART
        )
        across, down, closeness, near = _weight(at_x, at_y, x, y)
        weight = tl.where(usable, closeness, 0.0)
        u = tl.where(usable, u - level_u, 0.0)
        v = tl.where(usable, v - level_v, 0.0)
        by_x = weight * across
        by_y = weight * down
        within += tl.where(usable & (near > 0), 1.0, 0.0)
        mass += weight
        mass_x += by_x
        mass_y += by_y
        mass_xx += by_x * across
        mass_xy += by_x * down
        mass_yy += by_y * down
        data_u += weight * u
        data_ux += by_x * u
        data_uy += by_y * u
        data_v += weight * v
        data_vx += by_x * v
        data_vy += by_y * v
        if APART:
            nearest = tl.maximum(nearest, weight)
            theirs = known & (tl.load(apart + point, mask=point < count, other=0) != 0)
            for field in tl.static_range(5):
                value = tl.load(apart_fields + _FIELDS * point + field, mask=point < count, other=float("nan"))
                theirs = theirs & is_finite(value)
            closeness = tl.where(theirs, closeness, 0.0)
            closer = closeness > nearest_apart
            nearest_apart = tl.where(closer, closeness, nearest_apart)
            which = tl.where(closer, point, which)

    enough = tl.sum(within, 1)[:, None] >= _MINIMUM_POINTS
    total_mass = tl.where(enough, tl.sum(mass, 1)[:, None], 1.0)
    center_x = tl.sum(mass_x, 1)[:, None] / total_mass
    center_y = tl.sum(mass_y, 1)[:, None] / total_mass
    xx = tl.sum(mass_xx, 1)[:, None] / total_mass - center_x * center_x
    xy = tl.sum(mass_xy, 1)[:, None] / total_mass - center_x * center_y
    yy = tl.sum(mass_yy, 1)[:, None] / total_mass - center_y * center_y
    half = (xx + yy) / 2
    determinant = xx * yy - xy * xy
    narrowest = half - tl.sqrt(tl.maximum(half * half - determinant, 0.0))
    fitted = enough & (narrowest >= _MINIMUM_SPREAD * _MINIMUM_SPREAD) & (determinant > 1e-20)
    determinant = tl.where(fitted, determinant, 1.0)
    inverse_xx = yy / determinant
    inverse_xy = -xy / determinant
    inverse_yy = xx / determinant
    mean_u = tl.sum(data_u, 1)[:, None] / total_mass
    mean_v = tl.sum(data_v, 1)[:, None] / total_mass
    by_x = tl.sum(data_ux, 1)[:, None] / total_mass - mean_u * center_x
    by_y = tl.sum(data_uy, 1)[:, None] / total_mass - mean_u * center_y
    ux = (by_x * inverse_xx + by_y * inverse_xy) / radius
    uy = (by_x * inverse_xy + by_y * inverse_yy) / radius
    by_x = tl.sum(data_vx, 1)[:, None] / total_mass - mean_v * center_x
    by_y = tl.sum(data_vy, 1)[:, None] / total_mass - mean_v * center_y
    vx = (by_x * inverse_xx + by_y * inverse_xy) / radius
    vy = (by_x * inverse_xy + by_y * inverse_yy) / radius
    # G (I - G)^-1 = (I - G)^-1 - I, with little lost where G is small.
    ratio = (1 - ux) * (1 - vy) - uy * vx
    # Without an ellipse nothing is known.
    farthest = tl.where(good, _FARTHEST, 0.0)
    known = fitted & (center_x * center_x + center_y * center_y < farthest * farthest)
    known = known & (ratio > _LEAST_RATIO)
    ratio = tl.where(known, ratio, 1.0)
    lost = ux * vy - uy * vx
    ux = (ux - lost) / ratio
    uy = uy / ratio
    vx = vx / ratio
    vy = (vy - lost) / ratio
    exx = ux
    eyy = vy
    exy = (uy + vx) / 2
    if MEASURE != 2:
        exx += (ux * ux + vx * vx) / 2
        eyy += (uy * uy + vy * vy) / 2
    if MEASURE == 0:
        exy += (ux * uy + vx * vy) / 2
    divergence = ux + vy
    curl = vx - uy
    own = positions + frame * _ROWS * total + query
    if APART:
        largest = tl.max(nearest_apart, 1)[:, None]
        from_apart = largest > tl.max(nearest, 1)[:, None]
        chosen = tl.max(tl.where(nearest_apart == largest, which, 0), 1)[:, None]
        given = apart_fields + _FIELDS * chosen
        divergence = tl.where(from_apart, tl.load(given, mask=there, other=0.0), divergence)
        curl = tl.where(from_apart, tl.load(given + 1, mask=there, other=0.0), curl)
        exx = tl.where(from_apart, tl.load(given + 2, mask=there, other=0.0), exx)
        eyy = tl.where(from_apart, tl.load(given + 3, mask=there, other=0.0), eyy)
        exy = tl.where(from_apart, tl.load(given + 4, mask=there, other=0.0), exy)
        known = (from_apart & (largest > tl.where(good, _SAME_PLACE, 1.0))) | (known & (from_apart == 0))
        tl.store(own + _APART * total, tl.where(from_apart, 1.0, 0.0), mask=there)
        if NOISE:
            for field in tl.static_range(5):
                std = tl.load(apart_std + _FIELDS * chosen + field, mask=there, other=0.0)
                tl.store(own + (_STD + field) * total, std, mask=there)
    tl.store(own, divergence, mask=there)
    tl.store(own + total, curl, mask=there)
    tl.store(own + 2 * total, exx, mask=there)
    tl.store(own + 3 * total, eyy, mask=there)
    tl.store(own + 4 * total, exy, mask=there)
    tl.store(own + _KNOWN * total, tl.where(known, 1.0, 0.0), mask=there)
    tl.store(own + _GRADIENT * total, ux, mask=there)
    tl.store(own + (_GRADIENT + 1) * total, uy, mask=there)
    tl.store(own + (_GRADIENT + 2) * total, vx, mask=there)
    tl.store(own + (_GRADIENT + 3) * total, vy, mask=there)
    tl.store(own + _INVERSE * total, inverse_xx, mask=there)
    tl.store(own + (_INVERSE + 1) * total, inverse_xy, mask=there)
    tl.store(own + (_INVERSE + 2) * total, inverse_yy, mask=there)
    tl.store(own + _MASS * total, total_mass, mask=there)
    tl.store(own + _CENTROID * total, center_x + x, mask=there)
    tl.store(own + (_CENTROID + 1) * total, center_y + y, mask=there)


@triton.jit
def _take_medians(
    reference,
    displacement,
    ellipses,
    covariance,
    apart,
    positions,
    numbers,
    columns,
    count,
    total,
    references,
    radius,
    NOISE: tl.constexpr,
    APART: tl.constexpr,
    MEASURE: tl.constexpr,
    POSITIONS: tl.constexpr,
):
    frame = tl.program_id(0).to(tl.int64)
    middle_x, middle_y, major, minor, cosine, sine, good = _ellipse(ellipses, frame)
    field = tl.arange(0, 8)[:, None]
    position = tl.arange(0, POSITIONS)[None, :]
    there = position < total
    own = positions + frame * _ROWS * total + position
    known = there & (tl.load(own + _KNOWN * total, mask=there, other=0.0) > 0)
    fields = tl.load(own + field * total, mask=there & (field < _FIELDS), other=0.0)
    number = tl.sum(tl.where(known, 1, 0), 1)[:, None]
    lower = value_of_rank(fields, known, tl.maximum(number - 1, 0) // 2 + field * 0)
    upper = value_of_rank(fields, known, number // 2 + field * 0)
    median = (lower + upper) / 2
    enough = number >= _LEAST_SHARE * total
    median = tl.where(enough, median, float("nan"))
    result = numbers + frame * (2 * _FIELDS + 1)
    tl.store(result + field, median, mask=field < _FIELDS)
    share = tl.sum(tl.where(known, 1.0, 0.0)) / total
    tl.store(result + 2 * _FIELDS, tl.where(good, share, float("nan")))

    if NOISE:
        mean_xx = 0.0
        mean_xy = 0.0
        mean_yy = 0.0
        usable_points = 0.0
        reference += tl.where(references == 1, 0, frame) * count * 2
        displacement += frame * count * 2
        covariance += frame * count * 4
        apart += frame * count
        for first in range(0, count, POSITIONS):
            point = first + position
            at_x, at_y, present, usable, u, v = _points_at(
                reference, displacement, covariance, apart, middle_x, middle_y, point, count, radius, NOISE, APART
            )
            mean_xx += tl.sum(tl.load(covariance + 4 * point, mask=usable, other=0.0))
            mean_xy += tl.sum(tl.load(covariance + 4 * point + 1, mask=usable, other=0.0))
            mean_yy += tl.sum(tl.load(covariance + 4 * point + 3, mask=usable, other=0.0))
            usable_points += tl.sum(tl.where(usable, 1.0, 0.0))
        usable_points = tl.maximum(usable_points, 1.0)
        mean_xx = mean_xx / usable_points
        mean_xy = mean_xy / usable_points
        mean_yy = mean_yy / usable_points
        ux = tl.load(own + _GRADIENT * total, mask=there, other=0.0)
        uy = tl.load(own + (_GRADIENT + 1) * total, mask=there, other=0.0)
        vx = tl.load(own + (_GRADIENT + 2) * total, mask=there, other=0.0)
        vy = tl.load(own + (_GRADIENT + 3) * total, mask=there, other=0.0)
        mass = tl.load(own + _MASS * total, mask=there, other=1.0)
        inverse_xx = tl.load(own + _INVERSE * total, mask=there, other=0.0) / mass
        inverse_xy = tl.load(own + (_INVERSE + 1) * total, mask=there, other=0.0) / mass
        inverse_yy = tl.load(own + (_INVERSE + 2) * total, mask=there, other=0.0) / mass
        center_x = tl.load(own + _CENTROID * total, mask=there, other=0.0)
        center_y = tl.load(own + (_CENTROID + 1) * total, mask=there, other=0.0)
        # Derivatives of the fields with respect to du/dx, du/dy, dv/dx and dv/dy, with F = I + gradient.
        stretch = 0.0 if MEASURE == 2 else 1.0
        lean = 1.0 if MEASURE == 0 else 0.0
        of_ux = tl.where(field == 0, 1.0, 0.0) + tl.where(field == 2, 1 + stretch * ux, 0.0)
        of_ux += tl.where(field == 4, lean * uy / 2, 0.0)
        of_uy = tl.where(field == 1, -1.0, 0.0) + tl.where(field == 3, stretch * uy, 0.0)
        of_uy += tl.where(field == 4, (1 + lean * ux) / 2, 0.0)
        of_vx = tl.where(field == 1, 1.0, 0.0) + tl.where(field == 2, stretch * vx, 0.0)
        of_vx += tl.where(field == 4, (1 + lean * vy) / 2, 0.0)
        of_vy = tl.where(field == 0, 1.0, 0.0) + tl.where(field == 3, 1 + stretch * vy, 0.0)
        of_vy += tl.where(field == 4, lean * vx / 2, 0.0)
        # Variance of a field of a single fit among evenly spread points.
        even = _EVEN / (radius * radius)
        u_x = of_ux * inverse_xx + of_uy * inverse_xy
        u_y = of_ux * inverse_xy + of_uy * inverse_yy
        v_x = of_vx * inverse_xx + of_vy * inverse_xy
        v_y = of_vx * inverse_xy + of_vy * inverse_yy
        variance = mean_xx * (u_x * of_ux + u_y * of_uy) + mean_yy * (v_x * of_vx + v_y * of_vy)
        variance = even * (variance + 2 * mean_xy * (u_x * of_vx + u_y * of_vy))
        squared = (fields - median) * (fields - median)
        near = tl.maximum(1 - squared / tl.maximum(_REACH * _REACH * variance, _TINY), 0.0)
        share = tl.where(known, near * near, 0.0)
        joint = tl.zeros_like(median)
        if APART:
            from_apart = there & (tl.load(own + _APART * total, mask=there, other=0.0) > 0)
            std = tl.load(own + (_STD + field) * total, mask=from_apart & (field < _FIELDS), other=0.0)
            near = tl.maximum(1 - squared / tl.maximum(_REACH * _REACH * std * std, _TINY), 0.0)
            share = tl.where(from_apart, tl.where(known, near * near, 0.0), share)
        share = share / tl.maximum(tl.sum(share, 1)[:, None], 1.0)
        if APART:
            joint = tl.sum(tl.where(known & from_apart, share * std, 0.0), 1)[:, None]
            share = tl.where(from_apart, 0.0, share)
        tl.store(result + _FIELDS + field, tl.where(enough, joint, float("nan")), mask=field < _FIELDS)
        # The derivative of the mean: the sensitivities times (I + H)' A^-1 w / sum w, for a point and the centroid.
        onward_xx = (1 + ux) * inverse_xx + vx * inverse_xy
        onward_xy = (1 + ux) * inverse_xy + vx * inverse_yy
        onward_yx = uy * inverse_xx + (1 + vy) * inverse_xy
        onward_yy = uy * inverse_xy + (1 + vy) * inverse_yy
        row_ux = share * (of_ux * onward_xx + of_uy * onward_yx)
        row_uy = share * (of_ux * onward_xy + of_uy * onward_yy)
        row_vx = share * (of_vx * onward_xx + of_vy * onward_yx)
        row_vy = share * (of_vx * onward_xy + of_vy * onward_yy)
        to = columns + ((frame * _FIELDS + field) * _COLUMNS) * total + position
        stored = there & (field < _FIELDS)
        tl.store(to, row_ux, mask=stored)
        tl.store(to + total, row_uy, mask=stored)
        tl.store(to + 2 * total, row_ux * center_x + row_uy * center_y, mask=stored)
        tl.store(to + 3 * total, row_vx, mask=stored)
        tl.store(to + 4 * total, row_vy, mask=stored)
        tl.store(to + 5 * total, row_vx * center_x + row_vy * center_y, mask=stored)


@triton.jit
def _sum_errors(
    lattice,
    reference,
    displacement,
    ellipses,
    covariance,
    apart,
    columns,
    variance,
    count,
    total,
    references,
    radius,
    NOISE: tl.constexpr,
    APART: tl.constexpr,
    MEASURE: tl.constexpr,
    QUERIES: tl.constexpr,
    POINTS: tl.constexpr,
):
    frame = tl.program_id(2).to(tl.int64)
    field = tl.program_id(1)
    reference += tl.where(references == 1, 0, frame) * count * 2
    displacement += frame * count * 2
    covariance += frame * count * 4
    apart += frame * count
    middle_x, middle_y, major, minor, cosine, sine, good = _ellipse(ellipses, frame)
    point = (tl.program_id(0) * QUERIES + tl.arange(0, QUERIES))[:, None]
    at_x, at_y, known, usable, u, v = _points_at(
        reference, displacement, covariance, apart, middle_x, middle_y, point, count, radius, NOISE, APART
    )
    of_u = tl.zeros((QUERIES, POINTS), tl.float32)
    of_v = tl.zeros((QUERIES, POINTS), tl.float32)
    for first in range(0, total, POINTS):
        query = first + tl.arange(0, POINTS)[None, :]
        there = query < total
        x, y = _positions_at(lattice, query, there, major, minor, cosine, sine, radius)
        across, down, weight, near = _weight(at_x, at_y, x, y)
        own = columns + (frame * _FIELDS + field) * _COLUMNS * total + query
        moved = at_x * tl.load(own, mask=there, other=0.0) + at_y * tl.load(own + total, mask=there, other=0.0)
        of_u += weight * (moved - tl.load(own + 2 * total, mask=there, other=0.0))
        own += 3 * total
        moved = at_x * tl.load(own, mask=there, other=0.0) + at_y * tl.load(own + total, mask=there, other=0.0)
        of_v += weight * (moved - tl.load(own + 2 * total, mask=there, other=0.0))
    by_u = tl.sum(of_u, 1)[:, None] / radius
    by_v = tl.sum(of_v, 1)[:, None] / radius
    xx = tl.load(covariance + 4 * point, mask=usable, other=0.0)
    xy = tl.load(covariance + 4 * point + 1, mask=usable, other=0.0)
    yy = tl.load(covariance + 4 * point + 3, mask=usable, other=0.0)
    own_variance = by_u * by_u * xx + 2 * by_u * by_v * xy + by_v * by_v * yy
    to = (frame * _FIELDS + field) * tl.num_programs(0) + tl.program_id(0)
    tl.store(variance + to, tl.sum(own_variance))
