"""Shrinking of a fingertip's stick region under a tangential load (Terekhov & Hayward 2011, equations 3 to 5).

N is the normal and T the tangential force, mu_s and mu_k the coefficients of static and kinetic friction, d^2 the
stuck area over the contact area.
"""

import torch
from numpy.typing import ArrayLike
from torch import Tensor

# Rounding error, relative to mu_s^2, of the discriminant below for a computed load.
_ROUNDING = 16 * torch.finfo(torch.float64).eps


def load_ratio(stuck_area: Tensor | ArrayLike, mu_s: Tensor | ArrayLike, mu_k: Tensor | ArrayLike) -> Tensor:
    """Return the load ratio T/N of a contact with stuck area share d^2 (equations 3 and 4 of Terekhov & Hayward 2011).

        T/N = 2 mu_s d^2 (1 - d^2) + mu_k (1 - d^2)^2

    Args:
        stuck_area: d^2, from 0 to 1; other values give NaN.
        mu_s, mu_k: mu_s positive, mu_k 0 or more; all three broadcast.

    Returns:
        float64 tensor of the broadcast shape, differentiable. Below `critical_stuck_area` it is the unstable branch,
        which slow loading does not reach.

    Raises:
        ValueError: mu_s is not positive or mu_k is negative.
    """
    area, static, kinetic = _arguments(stuck_area, mu_s, mu_k)
    slipping = 1 - area
    load = slipping * (2 * static * area + kinetic * slipping)
    return torch.where((area >= 0) & (area <= 1), load, torch.nan)


def stuck_area(load_ratio: Tensor | ArrayLike, mu_s: Tensor | ArrayLike, mu_k: Tensor | ArrayLike) -> Tensor:
    """Return the stuck area share d^2 at a load ratio T/N under rising load (equation 5 of Terekhov & Hayward 2011).

    With mu_s = mu_k = mu it is (1 - T/(mu N))^(1/2). The paper prints 1 - T/(mu_k N), but with equal coefficients the
    term in d^2 drops out of equation 5, not the one in d^4.

    Args:
        load_ratio: T/N; the result is NaN where it is negative or above `critical_load_ratio`.
        mu_s, mu_k: mu_s positive, mu_k 0 or more; all three broadcast.

    Returns:
        float64 tensor of the broadcast shape: 1 without load, falling to `critical_stuck_area` at the critical load
        where mu_k < mu_s, and to 0 where mu_k >= mu_s. It is differentiable; a NaN has gradient 0. At the critical
        load the slope is infinite: rounding of 1e-16 in the load changes the area by 1e-8. A load within rounding
        of the critical one is therefore treated as critical. The gradient there is that of 1 - (T/N) / mu_s, finite so
        that a fit which crosses it continues.

    Raises:
        ValueError: mu_s is not positive or mu_k is negative.
    """
    load, static, kinetic = _arguments(load_ratio, mu_s, mu_k)
    # Equation 5 in the slipping share x = 1 - d^2: (2 mu_s - mu_k) x^2 - 2 mu_s x + T/N = 0. Its smaller root, with the
    # square root in the denominator, has no cancellation. It also holds where 2 mu_s = mu_k (a linear equation) and
    # where mu_k > 2 mu_s (a parabola of the opposite sign).
    discriminant = static.square() - (2 * static - kinetic) * load
    at_fold = (kinetic < static) & (discriminant.abs() <= _ROUNDING * static.square())
    fades = kinetic >= static
    within = torch.where(fades, load <= kinetic * (1 + _ROUNDING), (discriminant > 0) | at_fold) & (load >= 0)
    inside = within & ~at_fold & (discriminant > 0)
    root = torch.where(inside, torch.where(inside, discriminant, 1).sqrt(), 0)
    return torch.where(within, (1 - load / (static + root)).clamp(min=0), torch.nan)


def critical_stuck_area(mu_s: Tensor | ArrayLike, mu_k: Tensor | ArrayLike) -> Tensor:
    """Return the critical stuck area share (mu_s - mu_k) / (2 mu_s - mu_k), below which the contact slips as a whole.

    Such a minimal area needs mu_s > mu_k; the paper's section 1 and equation 5 agree, but its abstract has the
    inequality reversed. It is 0 for mu_s = mu_k, and NaN for mu_s < mu_k, where none exists.

    Raises:
        ValueError: mu_s is not positive or mu_k is negative.
    """
    static, kinetic = _friction(mu_s, mu_k)
    exists = kinetic <= static
    curvature = torch.where(exists, 2 * static - kinetic, 1)
    return torch.where(exists, (static - kinetic) / curvature, torch.nan)


def critical_load_ratio(mu_s: Tensor | ArrayLike, mu_k: Tensor | ArrayLike) -> Tensor:
    """Return the largest T/N of a contact without full slip: mu_s^2 / (2 mu_s - mu_k) for mu_k < mu_s, else mu_k.

    Raises:
        ValueError: mu_s is not positive or mu_k is negative.
    """
    static, kinetic = _friction(mu_s, mu_k)
    folds = kinetic < static
    return torch.where(folds, static.square() / torch.where(folds, 2 * static - kinetic, 1), kinetic)


def friction_ratio(critical_stuck_area: Tensor | ArrayLike) -> Tensor:
    """Return mu_k / mu_s from the stuck area share d^2 at which the remaining stick region slips at once.

    It solves d^2 = (mu_s - mu_k) / (2 mu_s - mu_k). The paper prints (1 - d^2) / (2 - d^2), which is no solution: it
    gives mu_k = mu_s / 2 where the area fades to nothing, although the two are equal there.

    Args:
        critical_stuck_area: d^2 from 0 to 1/2, where mu_k = 0; other values give NaN.
    """
    area = torch.as_tensor(critical_stuck_area, dtype=torch.float64)
    possible = (area >= 0) & (area <= 0.5)
    return torch.where(possible, (1 - 2 * area) / torch.where(possible, 1 - area, 1), torch.nan)


def _arguments(first: Tensor | ArrayLike, mu_s: Tensor | ArrayLike, mu_k: Tensor | ArrayLike) -> tuple[Tensor, ...]:
    return torch.broadcast_tensors(torch.as_tensor(first, dtype=torch.float64), *_friction(mu_s, mu_k))


def _friction(mu_s: Tensor | ArrayLike, mu_k: Tensor | ArrayLike) -> tuple[Tensor, Tensor]:
    static, kinetic = (torch.as_tensor(value, dtype=torch.float64) for value in (mu_s, mu_k))
    if (static <= 0).any():
        raise ValueError(f"mu_s is {static.min().item():g}: a coefficient of static friction is above 0")
    if (kinetic < 0).any():
        raise ValueError(f"mu_k is {kinetic.min().item():g}: a coefficient of kinetic friction is 0 or more")
    return static, kinetic
