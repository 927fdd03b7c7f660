"""The curves d^2(T/N) that the model of partial slip is compared with; each has one coefficient of friction."""

import torch
from numpy.typing import ArrayLike
from torch import Tensor


def coulomb_stuck_area(load_ratio: Tensor | ArrayLike, mu: Tensor | ArrayLike) -> Tensor:
    """The whole contact holds until T/N = mu and then slips at once: d^2 is 1, and NaN beyond.

    Args:
        load_ratio: T/N, 0 or more; negative values give NaN.
        mu: coefficient of friction, above 0; both broadcast.

    Raises:
        ValueError: mu is not positive. So in the other curves.
    """
    share = _carried(load_ratio, mu)
    return torch.where(share.isnan(), torch.nan, 1.0)


def equal_friction_stuck_area(load_ratio: Tensor | ArrayLike, mu: Tensor | ArrayLike) -> Tensor:
    """`stuck_area` for mu_s = mu_k = mu: d^2 = (1 - T/(mu N))^(1/2).

    Terekhov & Hayward 2011 print d^2 = 1 - T/(mu_k N) for it. But with equal coefficients the term in d^2 leaves their
    equation 5, not the one in d^4: mu d^4 = mu - T/N. The area fades to nothing, ever faster; NaN for T/N above mu.
    """
    return _powered(load_ratio, mu, 0.5)


def tada_stuck_area(load_ratio: Tensor | ArrayLike, mu: Tensor | ArrayLike) -> Tensor:
    """Tada et al. 2006: d^2 = (1 - T/(mu N))^(2/3), as Cattaneo and Mindlin have it for spheres; NaN above mu."""
    return _powered(load_ratio, mu, 2 / 3)


def _powered(load_ratio: Tensor | ArrayLike, mu: Tensor | ArrayLike, exponent: float) -> Tensor:
    share = _carried(load_ratio, mu)
    # The gradient is infinite at T/N = mu, as the curve's slope is, and 0 where the area is NaN.
    inside = share < 1
    area = torch.where(inside, 1 - share, 1).pow(exponent)
    return torch.where(share.isnan(), torch.nan, torch.where(inside, area, 0))


def _carried(load_ratio: Tensor | ArrayLike, mu: Tensor | ArrayLike) -> Tensor:
    """T/(mu N); NaN where it is not from 0 to 1."""
    load, friction = (torch.as_tensor(value, dtype=torch.float64) for value in (load_ratio, mu))
    if (friction <= 0).any():
        raise ValueError(f"mu is {friction.min().item():g}: a coefficient of friction is above 0")
    share = load / friction
    return torch.where((share >= 0) & (share <= 1), share, torch.nan)
