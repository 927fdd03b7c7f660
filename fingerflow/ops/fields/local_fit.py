"""Value and gradient of a field known at scattered points, from a weighted linear fit around each query position."""

import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.field_limits import MINIMUM_POINTS, MINIMUM_SPREAD
from fingerflow.kernels.result_records import LocalFit as LocalFit
from fingerflow.ops.fields.scattered import (
    check_batches,
    check_gauge_length,
    check_scattered,
    result_dtype,
    working_dtype,
)
from fingerflow.ops.fields.weighted_moments import weighted_moments
from fingerflow.ops.tensors import hypotenuse


def local_gradients(
    points: Tensor,
    values: Tensor,
    queries: Tensor | None = None,
    *,
    gauge_length: float,
    variance: Tensor | None = None,
    minimum_points: int = MINIMUM_POINTS,
) -> LocalFit:
    """Return value and gradient at each query position, from a weighted least-squares plane through the values around
    it.

    A point at distance r from the query has the weight (1 - (r/R)^2)^2 within R = gauge_length / 2, and 0 beyond.

    Args:
        points: (B, N, 2) positions (x, y) in a length unit L; reference positions if a strain is computed from the
            result.
        values: (B, N, C), for example a displacement (u, v) in L. Either batch may be 1. One set of points for many
            frames is several times faster than a set per frame, as the weights are shared.
        queries: (B, Q, 2) positions of the fits in L; the points themselves by default.
        gauge_length: diameter of the support in L. It sets the resolution: in a dense uniform cloud a sinusoid of
            wavelength w keeps 48 J3(k)/k^3 of its value and 384 J4(k)/k^4 of its slope, k = pi gauge_length / w (0.88
            of the slope at two gauge lengths per wave, 0.97 at four).
        variance: (B, N), the variance of each component of a value, or (B, N, C, C), its covariance, in value unit
            squared. If given, the covariance of the gradient is computed: A^-1 (sum w^2 s d d') A^-1, exact for this
            linear estimator and independent errors s. It does not include the smoothing above.
        minimum_points: at least 3, which a plane needs; the default adds two.

    Points with a non-finite position, value or variance, or a negative variance, are ignored. A query is NaN where
    fewer than `minimum_points` remain within the support. It is also NaN where their weighted standard deviation is
    below 5 % of the gauge length in some direction (collinear or coincident points). Queries at the border get a
    one-sided fit, which `centroid_offset` shows: 0 inside a uniform cloud, 0.15 gauge lengths on its straight border.

    Computed in float32 or wider, from differences to the query, so that only the rounding of the positions depends on
    the distance from the origin. Queries are processed in pieces to bound memory (autograd keeps them all).

    Raises:
        TypeError, ValueError: a dtype, shape or setting is invalid.

    Source: moving least squares, Lancaster & Salkauskas, Math. Comp. 37, 1981. Compiled twin: `kernels/local_fit.cpp`.

    Convention:
        axes: the last axis of points is (x, y); gradient[..., i, j] = d value_i / d x_j.
        sign: positive where the value grows along the axis.
        pixel centre: not used; points have any unit and origin.
        dtype: widest of the inputs.
        NaN: in a point or its value, leaves the point out; a query without a fit is NaN.
        border: one-sided fit, which `centroid_offset` shows.
    """
    queries = points if queries is None else queries
    _check(points, values, queries, variance)
    check_gauge_length(gauge_length)
    if minimum_points < 3:
        raise ValueError(f"minimum_points must be at least 3, which a plane needs, found {minimum_points}")
    inputs = (points, values, queries)
    dtype = working_dtype(*inputs)
    positions, measured, wanted = (tensor.to(dtype) for tensor in inputs)
    components, radius = values.shape[2], gauge_length / 2
    noise = None
    if variance is not None:
        noise = variance.to(dtype).flatten(2) if variance.dim() == 4 else variance.to(dtype)[..., None]
    if kernels.serve(positions, measured, wanted, noise):
        fit = kernels.local_gradients(positions, measured, wanted, noise, radius=radius, minimum_points=minimum_points)
        return LocalFit(
            *(part if part is None or not part.is_floating_point() else part.to(result_dtype(*inputs)) for part in fit)
        )

    # NaN becomes 0 with a weight of 0, rather than being masked at the end, so that derivatives stay finite.
    usable = torch.isfinite(positions).all(-1) & torch.isfinite(measured).all(-1)
    if noise is not None:
        diagonal = noise[..., :: components + 1] if noise.shape[2] == components**2 else noise
        usable = usable & torch.isfinite(noise).all(-1) & (diagonal >= 0).all(-1)
        noise = torch.where(usable[..., None], noise, 0)
    valid = torch.isfinite(wanted).all(-1)
    positions = torch.where(torch.isfinite(positions), positions, 0)
    wanted = torch.where(valid[..., None], wanted, 0)
    measured = torch.where(usable[..., None], measured, 0)
    # A constant does not change the slope: subtracting the mean saves its precision.
    level = (measured.sum(1, keepdim=True) / usable.sum(1)[:, None, None].clamp(min=1)).detach()
    measured = torch.where(usable[..., None], measured - level, 0)

    count, mass, first, second, data, noise_sums = weighted_moments(positions, wanted, usable, measured, noise, radius)
    count = torch.where(valid, count, 0)
    determined = count >= minimum_points

    # Moments about the weighted centroid; the fit there separates into a mean and a 2 x 2 system.
    safe_mass = torch.where(determined, mass, 1)
    centre = first / safe_mass[..., None]
    centre_x, centre_y = centre.unbind(-1)
    xx, xy, yy = (second / safe_mass[..., None]).unbind(-1)
    xx, xy, yy = xx - centre_x * centre_x, xy - centre_x * centre_y, yy - centre_y * centre_y
    narrowest = (xx + yy) / 2 - hypotenuse((xx - yy) / 2, xy)  # the smaller eigenvalue
    determined = determined & (narrowest >= (MINIMUM_SPREAD * radius) ** 2)
    determinant = torch.where(determined, xx * yy - xy * xy, 1)
    inverse = _matrix(yy, -xy, -xy, xx) / determinant[..., None, None]

    mean, moment_x, moment_y = (data / safe_mass[..., None, None]).unbind(-2)
    moments = torch.stack((moment_x, moment_y), dim=-1) - mean[..., None] * centre[..., None, :]
    gradient = moments @ inverse
    value = mean - (gradient * centre[..., None, :]).sum(-1) + level

    def or_nan(tensor: Tensor) -> Tensor:
        valid_fit = determined.reshape(determined.shape + (1,) * (tensor.dim() - 2))
        return torch.where(valid_fit, tensor, torch.nan).to(result_dtype(*inputs))

    covariance = None
    if noise_sums is not None:
        covariance = or_nan(_gradient_covariance(noise_sums, centre, safe_mass, inverse, components))
    offset = hypotenuse(centre_x, centre_y).detach()
    return LocalFit(or_nan(value), or_nan(gradient), covariance, count.to(torch.int64), or_nan(offset))


def _check(points: Tensor, values: Tensor, queries: Tensor, variance: Tensor | None) -> None:
    check_scattered(points, values)
    if not queries.is_floating_point() or queries.dim() != 3 or queries.shape[-1] != 2:
        raise ValueError(f"queries must be floating (B, Q, 2), found {queries.dtype} {tuple(queries.shape)}")
    check_batches(points=points, values=values, queries=queries)
    if variance is not None:
        allowed = (tuple(values.shape[1:2]), (values.shape[1], values.shape[2], values.shape[2]))
        if not variance.is_floating_point() or tuple(variance.shape[1:]) not in allowed:
            raise ValueError(
                f"variance must be floating (B, N) or (B, N, C, C) with N and C of values {tuple(values.shape)}, "
                f"found {variance.dtype} {tuple(variance.shape)}"
            )
        check_batches(points=points, values=values, variance=variance)


def _gradient_covariance(noise_sums: Tensor, centre: Tensor, mass: Tensor, inverse: Tensor, components: int) -> Tensor:
    """Return the covariance (B, Q, C, 2, C, 2) of the gradients of C components that weighted least squares fits around
    Q positions, from weighted sums of the noise variances of the points (`noise_sums`).

    It is A^-1 (sum w^2 s d d') A^-1, with d the distance from the centroid and s the variance of a value.
    """
    plain, along_x, along_y, xx, xy, yy = (noise_sums / mass.square()[..., None, None]).unbind(-2)  # (B, Q, V) each
    x, y = centre[..., :1], centre[..., 1:]
    xx = xx - 2 * x * along_x + x * x * plain
    xy = xy - x * along_y - y * along_x + x * y * plain
    yy = yy - 2 * y * along_y + y * y * plain
    bread = inverse[..., None, :, :]
    sandwich = bread @ _matrix(xx, xy, xy, yy) @ bread  # (B, Q, V, 2, 2)
    if sandwich.shape[2] == 1:
        between_components = torch.eye(components, dtype=sandwich.dtype, device=sandwich.device)
        return between_components[:, None, :, None] * sandwich[:, :, :, :, None, :]
    batch, queries = sandwich.shape[:2]
    return sandwich.reshape(batch, queries, components, components, 2, 2).transpose(3, 4)


def _matrix(a: Tensor, b: Tensor, c: Tensor, d: Tensor) -> Tensor:
    """Return 2 x 2 matrices (..., 2, 2) with the elements a, b, c and d, row by row."""
    return torch.stack((torch.stack((a, b), dim=-1), torch.stack((c, d), dim=-1)), dim=-2)
