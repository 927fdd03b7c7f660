"""Displacement gradients at tracked points, by local fits around each point."""

import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.ops.fields.local_fit import local_gradients
from fingerflow.ops.fields.plane_fit import Support, about_their_mean, fit_planes, gradient_covariance, point_support
from fingerflow.ops.tensors import finite, sum_rows


def point_gradients(
    reference: Tensor, displacement: Tensor, gauge_length: float, covariance: Tensor | None = None
) -> tuple[Tensor, Tensor | None, Tensor]:
    """Return displacement gradients (B, N, 2, 2) at N points, each from a weighted least-squares plane through the
    displacements within half a gauge length of the point, the gradients' covariance, and the planes' values (B, N, 2).

    Displacements are (B, N, 2), reference positions (1 or B, N, 2). With `covariance` (B, N, 2, 2) of the
    displacements, that of the gradients is (B, N, 2, 2, 2, 2), else None; gradients and covariance are as in
    `LocalFit`. They are NaN also where a point's own displacement, or its covariance, is not known. Compiled kernels
    fit differences of positions; the portable form, which is exported, uses matrix products (`ops.fields.plane_fit`).
    """
    if kernels.serve(reference, displacement, covariance):
        fit = local_gradients(reference, displacement, gauge_length=gauge_length, variance=covariance)
        across, down = displacement.unbind(-1)  # torch is slow over an axis of two
        total = across + down
        if covariance is not None:
            (xx, xy), (_, yy) = (row.unbind(-1) for row in covariance.unbind(-2))
            total = total + xy + xx.sqrt() + yy.sqrt()
        total = 0 * total[..., None, None]  # NaN where one is not finite, or a variance negative
        spread = None if fit.covariance is None else fit.covariance + total[..., None, None]
        return fit.gradient + total, spread, fit.value + total[..., 0]
    radius = gauge_length / 2
    positions, valid = about_their_mean(reference, radius)
    usable = valid & finite(sum_rows(displacement.mT))
    planes = None
    if covariance is not None:
        planes = covariance.flatten(2).mT[:, (0, 1, 3)]
        usable = usable & finite(sum_rows(planes)) & (planes[:, ::2] >= 0).all(1, keepdim=True)
        planes = torch.where(usable, planes, 0.0)
    fitted = fit_planes(positions, displacement.mT, positions, usable, radius)
    known, both = fitted.known & usable, (fitted.gradient, fitted.value)
    gradient, value = (torch.where(known, part, torch.nan).mT for part in both)
    gradient = gradient.unflatten(2, (2, 2))
    if planes is None:
        return gradient, None, value
    spread = gradient_covariance(fitted, positions, planes, radius) + 0 * gradient[..., None, None]
    return gradient, spread, value


def neighbours_support(reference: Tensor, gauge_length: float) -> Support | None:
    """Return the weights (`Support`) of points in the plane fits around each of them (`neighbour_planes`), for reuse in
    several fits: they depend on positions and gauge length only.

    `reference` is (1 or B, N, 2). None where compiled kernels run, which do not need it.
    """
    if kernels.serve(reference):
        return None
    positions, _ = about_their_mean(reference, gauge_length / 2)
    return point_support(positions, positions)


def neighbour_planes(
    reference: Tensor, values: Tensor, gauge_length: float, support: Support | None = None
) -> tuple[Tensor, Tensor]:
    """Fit a plane by weighted least squares to the values (B, N, C) within half a gauge length of each point; return
    the planes' values (B, N, C) at the points, and gradients (B, N, C, 2).

    The fits are those of `local_gradients` at `reference` (1 or B, N, 2). A point without a value of its own gets the
    fit of its neighbours. A point with one unknown component counts as unknown. Compiled and portable forms are as for
    `point_gradients`; the latter can reuse the `neighbours_support` of these positions.
    """
    if kernels.serve(reference, values):
        fit = local_gradients(reference, values, gauge_length=gauge_length)
        return fit.value, fit.gradient
    radius = gauge_length / 2
    positions, valid = about_their_mean(reference, radius)
    usable = valid & finite(sum_rows(values.mT))
    fitted = fit_planes(positions, values.mT, positions, usable, radius, support)
    determined = fitted.known & valid
    value, gradient = (torch.where(determined, values, torch.nan).mT for values in (fitted.value, fitted.gradient))
    return value, gradient.unflatten(2, (-1, 2))


def query_gradients(
    points: Tensor, values: Tensor, queries: Tensor, gauge_length: Tensor, variance: Tensor
) -> tuple[Tensor, Tensor]:
    """Return gradients (B, Q, 2, 2) at query positions (B, Q, 2), fitted to values (B, N, 2) at points (B, N, 2), and
    their covariance (B, Q, 2, 2, 2, 2) by the `variance` (B, N) of a component of each value.

    Gradients are NaN where the points do not determine them. This is the portable form of `local_gradients` at fixed
    cost, which is exported. `gauge_length` (1,) is in the unit of the points.
    """
    radius = gauge_length.to(points.dtype) / 2
    both = about_their_mean(torch.cat((points, queries), dim=1), radius)
    sizes = points.shape[1], queries.shape[1]
    (positions, targets), (valid, valid_targets) = (tensor.split(sizes, dim=2) for tensor in both)
    noise = variance[:, None]
    usable = valid & finite(sum_rows(values.mT)) & finite(noise) & (noise >= 0)
    fitted = fit_planes(positions, values.mT, targets, usable, radius)
    gradient = torch.where(fitted.known & valid_targets, fitted.gradient, torch.nan).mT.unflatten(2, (2, 2))
    noise = torch.where(usable, noise, 0.0)
    spread = gradient_covariance(fitted, positions, torch.cat((noise, 0 * noise, noise), dim=1), radius)
    return gradient, spread + 0 * gradient[..., None, None]
