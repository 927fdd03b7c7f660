"""Medians of divergence, curl and strain over the contact ellipse, from displacements of scattered points.

Compiled twin: `kernels/area_medians.cpp`.
"""

import math
from functools import partial
from typing import Any

import torch
from torch import Tensor

from fingerflow.kernels import field_limits as limits
from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.result_records import EnteredPoints, FrameEllipse
from fingerflow.ops.branching import may_branch
from fingerflow.ops.fields.plane_fit import PlaneFit, fit_planes
from fingerflow.ops.fields.scattered import check_gauge_length, check_scattered
from fingerflow.ops.fields.strain import check_measure, sensitivity_parts, strain_parts
from fingerflow.ops.fields.strain_uncertainty import field_std
from fingerflow.ops.pieces import in_pieces
from fingerflow.ops.tensors import constant_like, finite, products, sum_rows, symmetric

_FAR = 1e3  # radii: coordinate of excluded points, far from all positions
_TINY = 1e-30
_FIELDS = 5
_FRAMES = 8  # frames that have about the same known points
_PAIRS = 1 << 20  # pairs of a point and a position in the frames computed at once

_LATTICE = torch.from_numpy(limits.lattice())
# Change of the five fields by an isotropic expansion whose divergence is 1.
_EXPANSION = torch.tensor(((1, 0, 0.5, 0.5, 0),), dtype=torch.float64)


# Medians of divergence, curl and strain (B, 5), their standard deviations, and the share of each ellipse that is known.
_Medians = tuple[Tensor, Tensor | None, Tensor]


def area_medians(
    reference: Tensor,
    displacement: Tensor,
    ellipse: FrameEllipse,
    *,
    gauge_length: float,
    measure: str = "green_lagrange",
    covariance: Tensor | None = None,
    entered: EnteredPoints | None = None,
) -> _Medians:
    """Compute the medians (B, 5) of divergence, curl (rad) and strain (exx, eyy, exy) over the ellipse of each current
    (deformed) frame, from local plane fits to the displacements of scattered points.

    Their standard deviations (B, 5) are returned too, None without a covariance, and the share (B,) of the ellipse in
    which the fields are known, NaN where there is no ellipse.

    The fields are in reference coordinates. The gradient G of the displacement with respect to current coordinates is
    fitted as in `local_gradients` at 800 positions. They are spread evenly in the ellipse (a Fibonacci lattice, Vogel
    1979). The gradient with respect to reference coordinates is G (I - G)^-1. The median is thus weighted by current
    area. A median over the points would differ, since they crowd where skin has texture. So would one over reference
    positions, since expanding skin covers more of the area than before.

    A median is NaN where the field is known over less than 0.85 of the ellipse. A position is known if its fit
    satisfies the conditions of `local_gradients` and has points on all sides. Another position takes the fields of the
    nearest one that is known, up to a distance of a quarter of a gauge length, and counts as known then. Its
    trace of the strain is that of a plane fitted to those known within a gauge length, the divergence differing by as
    much, unless the nearest position has the fields of a point that entered.

    Args:
        reference: (1 or B, N, 2) reference positions in a length unit L.
        displacement: (B, N, 2) in L; NaN where a point is not known.
        ellipse: in L, with B frames; medians are NaN where a semi-axis is not positive.
        gauge_length: diameter of the support of a fit, L.
        measure: of strain, as in `green_lagrange`.
        covariance: (B, N, 2, 2) of a point's displacement, L^2, with independent errors of the points. If given,
            standard deviations are computed. The error of a median is the mean error at the positions whose field
            equals it to within the uncertainty of a fit, by whose inverse they are weighted, as an uncertain field
            is seldom near the median: to first order a sum over the points. It does not include the error of the
            ellipse or the smoothing over the gauge length.
        entered: points whose displacement has another onset than that of the others, such as those advected into the
            contact. They are left out of the fits. A position whose nearest point is one of them, with a known
            gradient, has the fields of that point up to a distance of a quarter of a gauge length, and is unknown
            beyond. The errors of these fields are taken as fully correlated.

    Raises:
        TypeError, ValueError: a dtype, shape or setting is invalid.
    """
    _check(reference, displacement, ellipse, gauge_length, covariance)
    check_measure(measure)
    dtype = displacement.dtype
    frame = [tensor.to(dtype) for tensor in ellipse]
    among = fields = std = None
    if entered is not None and displacement.shape[1]:
        among, fields = entered.among, _fields(entered.gradient.flatten(2).mT, measure).mT.to(dtype)
        if covariance is not None and entered.covariance is not None:
            std = field_std(entered.gradient, entered.covariance, measure).to(dtype)
    if dtype == torch.float32 and kernels.serve(reference, displacement, *frame, covariance, among, fields, std):
        center, semi_axes, angle = frame
        ellipses = torch.cat((center, semi_axes, angle.cos()[:, None], angle.sin()[:, None]), dim=1)
        noise = None if covariance is None else covariance.to(dtype)
        number, radius = limits.STRAIN_MEASURES.index(measure), gauge_length / 2
        tensors = reference, displacement, ellipses, noise, among, fields, std
        return kernels.area_medians(*tensors, measure=number, radius=radius)
    compute = partial(_medians_of_known, gauge_length / 2, measure)
    return in_pieces(compute, _FRAMES, *frame, reference, displacement, covariance, among, fields, std)


def _medians_of_known(radius: float, measure: str, *tensors: Any) -> _Medians:
    """Leave out points that are unknown in every frame, then compute the medians of divergence, curl and strain over
    the ellipses by `_medians`, from local fits of the given `radius`.

    All points are used while torch traces a graph.

    The known points are few while a contact grows.
    """
    frame, reference, displacement, points = tensors[:3], tensors[3], tensors[4], list(tensors[3:])
    count, compute = displacement.shape[1], partial(_medians, radius, measure)
    if may_branch(*points):
        valid = finite((reference + displacement).sum(2)).any(0)
        valid[:1] = True
        index = valid.nonzero().squeeze(1)
        points, count = [None if tensor is None else tensor.index_select(1, index) for tensor in points], len(index)
    return in_pieces(compute, _PAIRS // (max(count, len(_LATTICE)) * len(_LATTICE)), *frame, *points)


def _medians(
    radius: float, measure: str, center: Tensor, semi_axes: Tensor, angle: Tensor, reference: Tensor,
    displacement: Tensor, covariance: Tensor | None, among: Tensor | None, fields_entered: Tensor | None,
    std_entered: Tensor | None,
) -> _Medians:  # fmt: skip
    """Compute the medians of divergence, curl and strain over the ellipse of each frame, from plane fits within
    `radius` to point displacements, by matrix products that can be exported to ONNX.

    The cost is fixed. Of the points `among` (B, N) that entered the contact, the fields and their standard deviations
    are (B, N, 5), or None.
    """
    reference, displacement = reference.mT, displacement.mT  # components before points from here on
    if covariance is not None:
        covariance = covariance.flatten(2).mT[:, (0, 1, 3)]  # (B, 3, N), uu, uv, vv
    now = reference + displacement
    valid = finite(sum_rows(now))
    good = finite(torch.cat((center, semi_axes, angle[:, None]), dim=1)).all(1, keepdim=True)
    good = (good & (semi_axes > 0).all(1, keepdim=True))[..., None]
    middle, axes, turn = (
        torch.where(good, tensor, 0.0) for tensor in (center[..., None], semi_axes[..., None], angle[:, None, None])
    )
    usable, theirs = valid, None
    if covariance is not None:
        usable = usable & finite(sum_rows(covariance)) & (covariance[:, ::2] >= 0).all(1, keepdim=True)
    if among is not None and fields_entered is not None:
        usable = usable & ~among[:, None]
        theirs = valid & among[:, None] & finite(sum_rows(fields_entered.mT))
    # Points that are neither usable nor entered are moved away, so that none is the nearest.
    counts, elsewhere = (usable, 0.0) if theirs is None else (usable | theirs, _FAR)
    positions_scaled = torch.where(counts, (now - middle) / radius, elsewhere)
    cosine, sine = turn.cos(), turn.sin()
    along, across = (axes / radius * constant_like(_LATTICE, displacement).T).split(1, dim=1)
    positions = torch.cat((along * cosine - across * sine, along * sine + across * cosine), dim=1)
    fit = fit_planes(positions_scaled, displacement, positions, usable, radius)
    xx, xy, yx, yy = fit.gradient.split(1, dim=1)
    # G (I - G)^-1 = (I - G)^-1 - I, with little lost where G is small.
    ratio = (1 - xx) * (1 - yy) - xy * yx
    offset = fit.centroid - positions
    clear = (
        fit.known
        & good
        & (sum_rows(offset * offset) < (2 * limits.FARTHEST_CENTROID) ** 2)
        & (ratio > limits.LEAST_RATIO)
    )
    lost = xx * yy - xy * yx
    gradient = torch.cat((xx - lost, xy, yx, yy - lost), dim=1) / torch.where(clear, ratio, 1.0)
    fields = _fields(gradient, measure)
    nearest, std = torch.zeros_like(clear), None
    if fields_entered is not None and theirs is not None:
        values = fields_entered if std_entered is None else torch.cat((fields_entered, std_entered), dim=2)
        nearest, values, closest = _nearest_values(values, theirs, fit.weights)
        std = None if std_entered is None else values[:, _FIELDS:]
        fields = torch.where(nearest, values[:, :_FIELDS], fields)
        within = closest > (1 - limits.SAME_PLACE**2) ** 2
        clear = (nearest & within & good) | (clear & ~nearest)  # ONNX runtimes: no `where` of bool
    fields, filled = _with_rim(fields, positions, clear, nearest)
    count = filled.to(fields.dtype).sum(2, keepdim=True)
    share = (count / fields.shape[2])[..., 0]
    enough = share >= limits.LEAST_SHARE
    median = torch.where(enough, _median(fields, filled, count), math.nan)
    known_share = torch.where(good[..., 0], share, math.nan)[:, 0]
    if covariance is None:
        return median, None, known_share

    covariance, joint = torch.where(usable, covariance, 0.0), torch.zeros_like(median)
    xx, xy, yx, yy = gradient.split(1, dim=1)
    parts = sensitivity_parts(xx, xy, yx, yy, measure)
    sensitivity = torch.cat(parts, dim=1).unflatten(1, (_FIELDS, 2, 2))
    variance = _even_variance(fit, sensitivity, covariance, radius)
    if std is not None:
        variance = torch.where(nearest, std.square(), variance)
    # Errors at positions enter those of the medians with weights (1 - z^2)^2 / r, z the distance of the field from the
    # median in units of the reach r, `REACH` standard deviations.
    square = (limits.REACH**2 * variance).clamp_min(_TINY)
    share = (1 - (fields - median[..., None]).square() / square).clamp_min(0).square() * square.rsqrt() * clear
    share = share / share.sum(2, keepdim=True).clamp_min(_TINY)
    if std is not None:
        joint = (share * nearest * std).sum(2)
        share = share * ~nearest
    x, y = (_mean_derivatives(fit, positions_scaled, gradient, share, sensitivity) / radius).unbind(2)  # (B, 5, N)
    uu, uv, vv = covariance.split(1, dim=1)
    variance = (x * x * uu + 2 * x * y * uv + y * y * vv).sum(2) + joint * joint
    return median, torch.where(enough, variance.clamp_min(0).sqrt(), math.nan), known_share


def _median(fields: Tensor, valid: Tensor, count: Tensor) -> Tensor:
    """Return the medians (B, 5) of five fields (B, 5, Q) over those of the Q positions where the fields are `valid`.

    `count` (B, 1, 1) is the number of known values. The median is arbitrary where they are fewer than half.
    """
    falling = torch.where(valid, fields, -math.inf).topk(fields.shape[2] // 2 + 1, dim=2).values
    # Both ranks are the same where the count is odd.
    ranks = torch.cat(((count - 1).clamp_min(0) / 2, count / 2), dim=2).floor()
    return falling.gather(2, ranks.to(torch.int64).expand(-1, _FIELDS, -1)).mean(2)


def _with_rim(fields: Tensor, positions: Tensor, clear: Tensor, entered: Tensor) -> tuple[Tensor, Tensor]:
    """Return the fields (B, 5, Q) with those of positions that are not `clear` (B, 1, Q) taken from the clear ones
    around them, and whether they are known then (B, 1, Q), as one of these is near enough.

    Points end before the border of the contact, and medians without its rim would be those of the inner part. There
    the expansion falls steeply: the trace of the strain follows planes fitted within a gauge length, the divergence
    changes by as much, exx and eyy by half of it. Rotation and shear turn with the border, and fields of points that
    `entered` (B, 1, Q) count from another time: there the values of the nearest position are more accurate.
    """
    planes = fit_planes(positions / 2, sum_rows(fields[:, 2:4]), positions / 2, clear, 2.0)
    columns = torch.cat((fields, entered.to(fields.dtype)), dim=1).mT
    _, values, closest = _nearest_values(columns, clear, planes.weights * clear)
    beside, of_entered = values.split((_FIELDS, 1), dim=1)
    change = torch.where(planes.known & (of_entered < 0.5), planes.value - sum_rows(beside[:, 2:4]), 0.0)
    within = clear | (closest > (1 - limits.SAME_PLACE**2 / 4) ** 2)
    return torch.where(clear, fields, beside + constant_like(_EXPANSION, fields).T * change), within


def _nearest_values(values: Tensor, theirs: Tensor, weights: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return, for each of Q positions, whether its nearest point is among those with values (B, 1, Q), the values of
    that point (B, C, Q), and its weight (B, 1, Q).

    `weights` (B, Q, N) are those of `Support`, which fall with distance; `theirs` (B, 1, N) is True where the `values`
    (B, N, C) of points are known.
    """
    closest = weights.amax(2, keepdim=True)
    columns = torch.cat((torch.ones_like(theirs), theirs), dim=1).to(weights.dtype).mT
    columns = torch.cat((columns, torch.where(theirs.mT, values, 0.0)), dim=2)
    # A product with 0 and 1: gathering is far slower in ONNX runtimes.
    nearest_values = ((weights == closest).to(weights.dtype) @ columns).mT
    count, of_them = nearest_values[:, :1], nearest_values[:, 1:2]
    return of_them > count / 2, nearest_values[:, 2:] / of_them.clamp_min(1), closest.mT


def _fields(gradient: Tensor, measure: str) -> Tensor:
    """Return the five fields divergence, curl, exx, eyy and exy (B, 5, Q) of displacement gradients (B, 4, Q)."""
    xx, xy, yx, yy = gradient.split(1, dim=1)
    return torch.cat((xx + yy, yx - xy, *strain_parts(xx, xy, yx, yy, measure)), dim=1)


def _even_variance(fit: PlaneFit, sensitivity: Tensor, covariance: Tensor, radius: float) -> Tensor:
    """Return the variance (B, 5, Q) of five fields at Q positions by fits among evenly spread points, for which sum w^2
    d d' is 0.4 sum w d d'. The covariance of each point is taken as the mean, as much larger as the variances around
    the position are.

    `covariance` (B, 3, N) is 0 for points that are not usable; `sensitivity` (B, 5, 2, 2, Q) are the derivatives of the
    fields with respect to displacement gradients.
    """
    mean, noise = symmetric(covariance.sum(2, keepdim=True)), covariance[:, ::2].sum(1, keepdim=True)
    local = (fit.weights @ noise.mT).mT / noise.sum(2, keepdim=True).clamp_min(_TINY)
    slopes = symmetric(limits.EVEN / radius**2 * local * fit.inverse / fit.mass**2)
    return (products(mean[:, None], products(sensitivity, slopes[:, None])) * sensitivity).sum((2, 3))


def _mean_derivatives(fit: PlaneFit, positions: Tensor, gradient: Tensor, share: Tensor, sensitivity: Tensor) -> Tensor:
    """Return the derivatives (B, 5, 2, N) of the means of five fields (divergence, curl and strain), weighted by
    `share` over Q positions, with respect to the displacement components of N points.

    The mean is over positions with weights `share` (B, 5, Q). If a point is displaced by d, the gradient H at a
    position changes by d l', l = (I + H)' A^-1 w (x - c) / sum w. The point moves together with its displacement, so
    the fit changes by (I - G) d, and I - G cancels I + H.
    """
    xx, xy, yx, yy = gradient.split(1, dim=1)
    onward = torch.cat((1 + xx, yx, xy, 1 + yy), dim=1).unflatten(1, (2, 2))  # (I + H)'
    around = products(onward, symmetric(fit.inverse / fit.mass))
    # Derivatives with respect to the position of a point, and to that of the centroid.
    around = torch.cat((around, products(around, fit.centroid[:, :, None])), dim=2)  # (B, 2, 3, Q)
    columns = (products(sensitivity, around[:, None]) * share[:, :, None, None]).flatten(1, 3)
    sums = (columns @ fit.weights).unflatten(1, (_FIELDS, 2, 3))  # (B, 5, 2, 3, N)
    return (sums[:, :, :, :2] * positions[:, None, None]).sum(3) - sums[:, :, :, 2]


def _check(
    reference: Tensor, displacement: Tensor, ellipse: FrameEllipse, gauge_length: float, covariance: Tensor | None
) -> None:
    check_scattered(reference, displacement)
    if displacement.shape[2] != 2 or reference.dtype != displacement.dtype:
        raise ValueError(
            f"displacement must be (B, N, 2) of the type of reference, found {tuple(displacement.shape)} "
            f"{displacement.dtype} and {reference.dtype}"
        )
    batch, points = displacement.shape[:2]
    if reference.shape[0] not in (1, batch):
        raise ValueError(f"reference has {reference.shape[0]} frames, displacement {batch}: the same, or 1 are needed")
    for name, values, shape in zip(ellipse._fields, ellipse, ((batch, 2), (batch, 2), (batch,)), strict=True):
        if not values.is_floating_point() or values.shape != shape:
            raise ValueError(f"{name} must be floating {shape}, found {values.dtype} {tuple(values.shape)}")
    check_gauge_length(gauge_length)
    if covariance is not None and covariance.shape != (batch, points, 2, 2):
        raise ValueError(f"covariance must be {(batch, points, 2, 2)}, found {tuple(covariance.shape)}")
