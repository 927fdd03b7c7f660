"""Compression of a skin arc that sticks to the glass when a hemisphere is flattened (Willemet et al. 2021).

The arc L from the first point of contact to the edge becomes the contact radius a. With the arc angle theta,
cos theta = 1 - delta / R, that is L = R theta and a = R sin theta (equation 9). The strain (L - a) / L (equation 10) is
1 - sin theta / theta, about theta^2 / 6 for a small angle. There the printed difference loses all digits to rounding.
"""

import math

import torch
from torch import Tensor

# Coefficients of t^k, k = 1, 2, ..., in theta^2 = 4 asin^2(sqrt(t / 2)), with t = delta / R. theta^2 is smooth at t =
# 0; theta itself is not.
_SQUARED_ANGLE = tuple(2.0 * 2.0**k / (k * k * math.comb(2 * k, k)) for k in range(1, 20))
# Coefficients of theta^(2 k), k = 1, 2, ..., in 1 - sin theta / theta.
_SHORTENING = tuple((-1.0) ** (k + 1) / math.factorial(2 * k + 1) for k in range(1, 12))
# Largest t at which the series are used: there the terms of the first fall by a factor of 8, of the second by at least
# 12.
_SERIES_UP_TO = 0.25


def radial_strain(delta: Tensor | float, radius: Tensor | float) -> Tensor:
    """Return the compression (L - a) / L of the skin of a hemisphere that is indented by `delta`: its arc from pole to
    contact edge, of length L, is pressed flat to the contact radius a.

    It is exact to rounding and has the broadcast shape of the arguments. A frictionless contact releases this
    compression, a sticking one retains it: about 10 % at 3 mm and a radius of 10 mm. It is differentiable, also at
    delta = 0, where it is delta / (3 R).

    Args:
        delta: normal indentation, 0 to the radius, in the unit of the radius.
        radius: of the fingertip, positive.

    Raises:
        ValueError: an indentation or a radius out of range, or NaN.
    """
    ratio = _ratio(delta, radius)[0]
    small = ratio < _SERIES_UP_TO
    angle = 2 * torch.asin((torch.where(small, 1.0, ratio) / 2).sqrt())
    squared = torch.where(small, _series(_SQUARED_ANGLE, torch.where(small, ratio, 0.0)), 0.0)
    return torch.where(small, _series(_SHORTENING, squared), 1 - torch.sin(angle) / angle)


def arc_length(delta: Tensor | float, radius: Tensor | float) -> Tensor:
    """Return the length R arccos((R - delta) / R) of the flattened skin arc of a hemisphere of radius R indented by
    delta.

    Arguments are those of `radial_strain`.
    """
    ratio, radius = _ratio(delta, radius)
    return 2 * radius * torch.asin((ratio / 2).sqrt())  # from 1 - cos theta = 2 sin^2(theta / 2)


def contact_radius(delta: Tensor | float, radius: Tensor | float) -> Tensor:
    """Return the contact radius sqrt(R^2 - (R - delta)^2) of a hemisphere of radius R that is indented by delta.

    Arguments are those of `radial_strain`.
    """
    ratio, radius = _ratio(delta, radius)
    return radius * (ratio * (2 - ratio)).sqrt()


def _ratio(delta: Tensor | float, radius: Tensor | float) -> tuple[Tensor, Tensor]:
    """Check the indentation `delta` and the radius of a hemisphere; return delta / radius and the radius, float64."""
    depth, size = (torch.as_tensor(value, dtype=torch.float64) for value in (delta, radius))
    if not ((size > 0) & (size < torch.inf)).all():
        raise ValueError(f"radius {_first_invalid(size, size > 0)}: give a positive length, in the unit of delta")
    allowed = (depth >= 0) & (depth <= size)
    if not allowed.all():
        depth, size = torch.broadcast_tensors(depth, size)
        raise ValueError(
            f"delta {_first_invalid(depth, allowed)} with a radius of {_first_invalid(size, allowed)}: "
            "a half-sphere is indented by 0 to its radius; give both in one unit"
        )
    return depth / size, size


def _first_invalid(values: Tensor, allowed: Tensor) -> float:
    """Return the first value that violates a condition or is not finite, for an error message."""
    wrong = values[~(allowed & values.isfinite())]
    return float((wrong if len(wrong) else values).flatten()[0])


def _series(coefficients: tuple[float, ...], variable: Tensor) -> Tensor:
    """Return the power series c1 x + c2 x^2 + ..., by Horner's rule."""
    total = torch.zeros_like(variable)
    for coefficient in reversed(coefficients):
        total = (total + coefficient) * variable
    return total
