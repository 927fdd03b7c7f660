"""Gradients of the displacement at the points themselves, at fixed cost."""

from typing import NamedTuple

import torch
from torch import Tensor

from fingerflow import kernels
from fingerflow.ops.local_fit import local_gradients
from fingerflow.ops.plane_fit import finite, fit_planes, gradient_covariance, sum_rows


def point_gradients(
    reference: Tensor, displacement: Tensor, gauge_length: float, covariance: Tensor | None = None
) -> tuple[Tensor, Tensor | None]:
    """`local_gradients` of displacements (B, N, 2) at reference positions (1 or B, N, 2), and their covariance.

    Gradient (B, N, 2, 2) and, with ``covariance`` (B, N, 2, 2) of the displacements, its covariance (B, N, 2, 2, 2, 2)
    as `LocalFit` has them; NaN also where a point's own displacement is not known. Compiled kernels fit from
    differences of positions; the portable form, which is exported, by products of matrices (`ops.plane_fit`).
    """
    if kernels.serve(reference, displacement, covariance):
        fit = local_gradients(reference, displacement, gauge_length=gauge_length, variance=covariance)
        own = torch.where(displacement.isfinite().all(-1), 0.0, torch.nan)[..., None, None]
        return fit.gradient + own, None if fit.covariance is None else fit.covariance + own[..., None, None]
    radius = gauge_length / 2
    usable = finite(sum_rows(reference.mT + displacement.mT))
    given = finite(sum_rows(reference.mT))
    number = given.to(reference.dtype)
    places = torch.where(given, reference.mT, 0.0)
    origin = places.sum(2, keepdim=True) / number.sum(2, keepdim=True).clamp_min(1)
    places = (places - origin) * number / radius
    planes = None
    if covariance is not None:
        planes = covariance.flatten(2).mT[:, (0, 1, 3)]
        usable = usable & finite(sum_rows(planes)) & (planes[:, ::2] >= 0).all(1, keepdim=True)
        planes = torch.where(usable, planes, 0.0)
    fitted = fit_planes(places, displacement.mT, places, usable, radius)
    gradient = torch.where(fitted.known & usable, fitted.gradient, torch.nan).mT.unflatten(2, (2, 2))
    if planes is None:
        return gradient, None
    return gradient, gradient_covariance(fitted, places, planes, radius) + 0 * gradient[..., None, None]


class NeighbourPlanes(NamedTuple):
    """What their neighbours say of N points: values (B, N, C) there, and gradients (B, N, C, 2)."""

    value: Tensor
    gradient: Tensor


def neighbour_planes(reference: Tensor, values: Tensor, gauge_length: float) -> NeighbourPlanes:
    """`local_gradients` of values (B, N, C), C even, at all given reference positions (1 or B, N, 2).

    Also where a point's own value is not known, from its neighbours. Forms as for `point_gradients`.
    """
    if kernels.serve(reference, values):
        fit = local_gradients(reference, values, gauge_length=gauge_length)
        return NeighbourPlanes(fit.value, fit.gradient)
    radius = gauge_length / 2
    given = finite(sum_rows(reference.mT))
    number = given.to(reference.dtype)
    places = torch.where(given, reference.mT, 0.0)
    origin = places.sum(2, keepdim=True) / number.sum(2, keepdim=True).clamp_min(1)
    places = (places - origin) * number / radius
    every = []
    for pair in values.mT.split(2, dim=1):
        fitted = fit_planes(places, pair, places, given & finite(sum_rows(pair)), radius)
        known = fitted.known & given
        every.append([torch.where(known, one, torch.nan) for one in (fitted.value, fitted.gradient)])
    value, gradient = (torch.cat(parts, dim=1).mT for parts in zip(*every, strict=True))
    return NeighbourPlanes(value, gradient.unflatten(2, (-1, 2)))
