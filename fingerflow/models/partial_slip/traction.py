"""Pressure and traction over an elliptical, partly stuck contact."""

import math

import torch
from numpy.typing import ArrayLike
from torch import Tensor


def pressure(
    x: Tensor | ArrayLike, y: Tensor | ArrayLike, normal_force: float, semi_axes: tuple[float, float]
) -> Tensor:
    """Return p(x, y), whose integral over the contact is the normal force (Terekhov & Hayward 2011, equation 1).

    Args:
        x, y: positions from the centre along the semi-axes, in one unit of length L; they broadcast.
        normal_force: N, in a unit of force F.
        semi_axes: a along x and b along y, in L, above 0.

    Returns:
        float64, in F / L^2; 0 outside of the contact.

    Raises:
        ValueError: a semi-axis is not positive.
    """
    share = (1 - _ellipse(x, y, semi_axes)).clamp(min=0)
    return _peak(normal_force, semi_axes) * share


def traction(
    x: Tensor | ArrayLike,
    y: Tensor | ArrayLike,
    stuck_area: float,
    mu_s: float,
    mu_k: float,
    normal_force: float,
    semi_axes: tuple[float, float],
) -> Tensor:
    """Return q(x, y) where the inner ellipse x^2/a^2 + y^2/b^2 <= d^2 sticks (equations 2 and 3 of the same paper).

    The traction is uniform in the stick region, mu_s times the pressure on its border, and mu_k p around it. Its
    integral over the contact is `load_ratio(stuck_area, mu_s, mu_k)` times the normal force.

    Args:
        x, y, normal_force, semi_axes: as in `pressure`.
        stuck_area: d^2, the stuck area over the contact area, from 0 to 1.
        mu_s, mu_k: coefficients of static and kinetic friction.

    Returns:
        float64, in F / L^2; 0 outside of the contact.

    Raises:
        ValueError: a semi-axis is not positive, or d^2 is not from 0 to 1.
    """
    if not 0 <= stuck_area <= 1:
        raise ValueError(f"the stuck area is {stuck_area:g} of the contact area: give a share from 0 to 1")
    stuck = _ellipse(x, y, semi_axes) <= stuck_area
    uniform = mu_s * _peak(normal_force, semi_axes) * (1 - stuck_area)
    return torch.where(stuck, uniform, mu_k * pressure(x, y, normal_force, semi_axes))


def _ellipse(x: Tensor | ArrayLike, y: Tensor | ArrayLike, semi_axes: tuple[float, float]) -> Tensor:
    if min(semi_axes) <= 0:
        raise ValueError(f"the semi-axes are {semi_axes}: both must be above 0")
    across, along = (torch.as_tensor(value, dtype=torch.float64) for value in (x, y))
    return (across / semi_axes[0]).square() + (along / semi_axes[1]).square()


def _peak(normal_force: float, semi_axes: tuple[float, float]) -> float:
    return 2 * normal_force / (math.pi * semi_axes[0] * semi_axes[1])
