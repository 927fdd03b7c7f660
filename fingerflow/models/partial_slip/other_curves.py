"""Curves d^2(T/N) with which the model of partial slip is compared; each has one coefficient of friction."""

import torch
from numpy.typing import ArrayLike
from torch import Tensor


def coulomb_stuck_area(load_ratio: Tensor | ArrayLike, mu: Tensor | ArrayLike) -> Tensor:
    """Return d^2 of a contact that sticks as a whole until T/N = mu and then slips at once: 1, and NaN beyond.

    Args:
        load_ratio: T/N, 0 or more; negative values give NaN.
        mu: coefficient of friction, above 0; both broadcast.

    Raises:
        ValueError: mu is not positive. The same holds for the other curves.
    """
    share = _carried(load_ratio, mu)
    return torch.where(share.isnan(), torch.nan, 1.0)


def equal_friction_stuck_area(load_ratio: Tensor | ArrayLike, mu: Tensor | ArrayLike) -> Tensor:
    """Return `stuck_area` for mu_s = mu_k = mu: d^2 = (1 - T/(mu N))^(1/2).

    Terekhov & Hayward 2011 print d^2 = 1 - T/(mu_k N). But with equal coefficients the term in d^2 drops out of their
    equation 5, not the one in d^4: mu d^4 = mu - T/N. The area fades to 0 ever faster; NaN for T/N above mu.
    """
    return _powered(load_ratio, mu, 0.5)


def tada_stuck_area(load_ratio: Tensor | ArrayLike, mu: Tensor | ArrayLike) -> Tensor:
    """Return d^2 = (1 - T/(mu N))^(2/3) (Tada et al. 2006), as Cattaneo and Mindlin for spheres; NaN above mu."""
    return _powered(load_ratio, mu, 2 / 3)


def _powered(load_ratio: Tensor | ArrayLike, mu: Tensor | ArrayLike, exponent: float) -> Tensor:
    share = _carried(load_ratio, mu)
    # At T/N = mu, where the curve's slope is infinite, and where the area is NaN the gradient is 0.
    inside = share < 1
    area = torch.where(inside, 1 - share, 1).pow(exponent)
    return torch.where(share.isnan(), torch.nan, torch.where(inside, area, 0))


def _carried(load_ratio: Tensor | ArrayLike, mu: Tensor | ArrayLike) -> Tensor:
    """Return T/(mu N); NaN outside of 0 to 1."""
    load, friction = (torch.as_tensor(value, dtype=torch.float64) for value in (load_ratio, mu))
    if (friction <= 0).any():
        raise ValueError(f"mu is {friction.min().item():g}: a coefficient of friction is above 0")
    share = load / friction
    return torch.where((share >= 0) & (share <= 1), share, torch.nan)
