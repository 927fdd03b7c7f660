"""Stress in a half-space under a surface load, in plane strain: Johnson, Contact Mechanics (1985), equation 2.23.

y runs along the surface, z down into the skin. A pressure p presses the surface down, a traction q pulls it along +y.
With r = y - s and R^2 = r^2 + z^2 the stresses are integrals over the surface, of -2 / pi times

    sigma_y:  p z r^2 / R^4 + q r^3 / R^4
    sigma_z:  p z^3 / R^4   + q z^2 r / R^4
    tau_yz:   p z^2 r / R^4 + q z r^2 / R^4

Equation 11 of Willemet et al. 2021 has the first two lines. The published script squares r in the p term of tau, which
makes an odd shear even, and omits q. At the surface sigma_z -> -p and tau_yz -> -q.

Every strip is integrated exactly. phi = atan(r / z) at its two ends, theta is their difference and Sigma their sum:

    integral of 2 z r^2 / R^4 = theta - sin theta cos Sigma = (theta - sin theta) + 2 sin theta sin^2(Sigma / 2)
    integral of 2 z^3 / R^4   = theta + sin theta cos Sigma = (theta - sin theta) + 2 sin theta cos^2(Sigma / 2)
    integral of 2 z^2 r / R^4 = sin theta sin Sigma
    integral of 2 r^3 / R^4   = 2 h - sin theta sin Sigma,  h = log(R_1 / R_2)

The right-hand forms add terms of one sign, so nothing cancels close to the surface, far to the side or far below it.
"""

import math
from functools import partial

import torch
from torch import Tensor

_PAIRS_AT_ONCE = 1 << 20  # largest number of pairs of a point and a strip in memory; a few tens of MB


def stress(
    y: Tensor | float, z: Tensor | float, edges: Tensor, pressure: Tensor, traction: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """Compute the stress at points (y, z), along the surface and in depth, of an elastic half-space whose surface
    carries a load that is constant on each of M strips, bounded by `edges`.

    Args:
        y: position along the surface, in the unit of the edges; y and z broadcast to a shape S.
        z: depth, positive.
        edges: (..., M + 1), rising; leading dimensions B broadcast with those of the loads.
        pressure: (..., M) on each strip, compression positive.
        traction: (..., M) along +y on the surface of the skin; none by default.

    Returns:
        sigma_y, sigma_z and tau_yz, each (*B, *S) float64 in the unit of the load, differentiable in all arguments.
        Tension is positive; the shear stress is positive where it pulls the upper side along -y.

    Raises:
        ValueError: shapes that do not match, edges that do not rise, a depth that is not positive, NaN.
    """
    edges, pressure, traction = _check_load(edges, pressure, traction)
    lateral, depth = torch.broadcast_tensors(*(torch.as_tensor(value, dtype=torch.float64) for value in (y, z)))
    if not ((depth > 0) & (depth < torch.inf) & lateral.isfinite()).all():
        raise ValueError(
            f"y from {float(lateral.min())} and z from {float(depth.min())}: give finite places with z > 0; the "
            "surface itself has sigma_z = -pressure and tau_yz = -traction"
        )
    at_once = max(1, _PAIRS_AT_ONCE // max(1, edges.numel()))
    parts = []
    for along, down in zip(lateral.reshape(-1, 1).split(at_once), depth.reshape(-1, 1).split(at_once), strict=True):
        first, second = along - edges[..., None, :-1], along - edges[..., None, 1:]
        z_rr, zzz, zz_r, rrr = _integrals(first, second, edges.diff(dim=-1)[..., None, :], down)
        pairs = ((z_rr, rrr), (zzz, zz_r), (zz_r, z_rr))
        over_strips = partial(torch.einsum, "...km,...m->...k")
        parts.append(torch.stack([over_strips(of_p, pressure) + over_strips(of_q, traction) for of_p, of_q in pairs]))
    whole = -torch.cat(parts, -1) / math.pi
    sigma_y, sigma_z, tau_yz = whole.reshape(*whole.shape[:-1], *lateral.shape)
    return sigma_y, sigma_z, tau_yz


def _integrals(first: Tensor, second: Tensor, width: Tensor, z: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Integrate four stress kernels over load strips of a given width, from each point's signed distances along the
    surface to the first and second edge of a strip and its depth z; return the integrals (..., points, M) of 2 z r^2,
    2 z^3, 2 z^2 r and 2 r^3, over R^4 each.
    """
    first_squared, second_squared = first * first + z * z, second * second + z * z
    both = (first_squared * second_squared).sqrt()
    between = first + second
    theta = torch.atan2(z * width, z * z + first * second)
    sine = z * width / both  # sin theta
    sine_sum, cosine_sum = z * between / both, (z * z - first * second) / both
    ahead = cosine_sum > 0
    # sin^2 and cos^2 of Sigma / 2: the smaller is computed from sin Sigma, the larger from cos Sigma.
    large = (1 + torch.where(ahead, cosine_sum, -cosine_sum)) / 2  # `abs` would have no slope at 0
    small = sine_sum * sine_sum / (4 * large)
    sine_half, cosine_half = torch.where(ahead, small, large), torch.where(ahead, large, small)
    small_angle = theta < 1
    excess = torch.where(small_angle, _odd_series(torch.where(small_angle, theta, 0.0), -1.0), theta - sine)
    zz_r = sine * sine_sum
    # h = log(R_1 / R_2); 2 h - sin theta sin Sigma = 2 (h - sinh h) + 2 sinh h (sin^2(theta/2) + sin^2(Sigma/2))
    growth = width * between
    right = growth >= 0
    nearer = torch.where(right, second_squared, first_squared)
    h = torch.where(right, 0.5, -0.5) * torch.log1p(growth.abs() / nearer)
    sinh = growth / both / 2
    half = torch.sin(theta / 2)
    near_one = h.abs() < 1
    # sinh h - h is the same series as theta - sin theta with all signs positive.
    careful = 2 * sinh * (half * half + sine_half) - 2 * _odd_series(torch.where(near_one, h, 0.0), 1.0)
    rrr = torch.where(near_one, careful, 2 * h - zz_r)
    return excess + 2 * sine * sine_half, excess + 2 * sine * cosine_half, zz_r, rrr


def _odd_series(value: Tensor, sign: float) -> Tensor:
    """Return the series value^3 / 3! + sign value^5 / 5! + value^7 / 7! + sign value^9 / 9! + ...

    For |value| < 1 it is, without cancellation, value - sin(value) with the sign -1 and sinh(value) - value with 1.
    """
    squared = value * value
    total = torch.zeros_like(value)
    for k in range(9, 0, -1):
        total = sign * squared * total + 1 / math.factorial(2 * k + 1)
    return total * squared * value


def _check_load(edges: Tensor, pressure: Tensor, traction: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
    edges, pressure = (torch.as_tensor(value, dtype=torch.float64) for value in (edges, pressure))
    traction = torch.zeros_like(pressure) if traction is None else torch.as_tensor(traction, dtype=torch.float64)
    for name, load in (("pressure", pressure), ("traction", traction)):
        strips = (edges.shape[-1] if edges.ndim else 1) - 1
        if not load.ndim or load.shape[-1] != strips or not strips:
            raise ValueError(
                f"{name} {tuple(load.shape)} on edges {tuple(edges.shape)}: give one value a strip, {strips} in the "
                "last dimension"
            )
        if not load.isfinite().all():
            raise ValueError(f"{name} has a value that is not finite: leave the frames out that are not known")
    if not (edges.diff(dim=-1) > 0).all() or not edges.isfinite().all():
        raise ValueError("edges do not rise from each to the next: sort strips along y and leave empty ones out")
    return edges, pressure, traction
