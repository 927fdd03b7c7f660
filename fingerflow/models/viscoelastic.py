"""Strain of a viscoelastic (Kelvin-Voigt) solid under stress: equation 12 of Willemet et al. 2021.

    eta de_y/dt + E e_y = sigma_y - nu sigma_z,   eta de_z/dt + E e_z = sigma_z - nu sigma_y

The rate is E / eta = 100 1/s: a time constant of 10 ms and a corner frequency of 100 / (2 pi) = 15.9 Hz, where the text
states 100 Hz. The equation is that of plane stress, where equations 2 and 11 of the paper are plane strain. Its Poisson
ratio is not printed: 0.4 is that of the paper's strain energy, 0.49 that of the lab's script.
"""

import math

import torch
from torch import Tensor

RECEPTOR_DEPTHS_M = (1.2e-3, 2e-3)  # depths of the paper's mechanoreceptors


def viscoelastic_strain(
    sigma_y: Tensor,
    sigma_z: Tensor,
    time: Tensor,
    *,
    young_modulus: Tensor | float = 1.1e6,
    rate: Tensor | float = 100.0,
    poisson_ratio: Tensor | float = 0.4,
) -> tuple[Tensor, Tensor]:
    """Compute the strain (T, ...), extension positive, along y and along z of a Kelvin-Voigt solid under
    stresses (T, ...), Pa, that are linear between the times (T,), s; it is exact for any time step.

    The strain is 0 at the first time, whatever the stress is then.

    Args:
        sigma_y, sigma_z: Pa, tension positive, as returned by `half_space.stress`, time in the first dimension.
        time: s, rising.
        young_modulus: E in Pa, positive. Like ``rate``, E / eta in 1/s, positive, and ``poisson_ratio``, nu, it is a
            number or a tensor that broadcasts with the stress at one time.

    Raises:
        ValueError: stresses of another shape, times that do not rise, a modulus or a rate that is not positive.
    """
    if sigma_y.shape != sigma_z.shape or not sigma_y.ndim or time.shape != sigma_y.shape[:1]:
        raise ValueError(
            f"sigma_y {tuple(sigma_y.shape)}, sigma_z {tuple(sigma_z.shape)}, time {tuple(time.shape)}: give (T, ...), "
            "the same, and (T,)"
        )
    if not (time.diff() > 0).all():
        raise ValueError(f"time has a smallest step of {float(time.diff().min())} s: every step must be positive")
    # Time in the last dimension, so that the parameters broadcast with the stress at one time.
    modulus, rates, ratio = (
        torch.as_tensor(value, dtype=torch.float64)[..., None] for value in (young_modulus, rate, poisson_ratio)
    )
    of_y, of_z = (stress.movedim(0, -1) for stress in (sigma_y, sigma_z))
    for name, value, unit in (("young_modulus", modulus, "Pa"), ("rate", rates, "1/s")):
        if not (value > 0).all():
            raise ValueError(f"{name} {value.min().item()} {unit}: give a positive one")
    delays = rates * time.double().diff()
    left, (early, late) = torch.exp(-delays), _step_weights(delays)

    def delayed(elastic: Tensor) -> Tensor:
        """Return the strain (T, ...) of viscoelastic skin whose equilibrium strain is `elastic` (..., T)."""
        gained = early * elastic[..., :-1] + late * elastic[..., 1:]
        strains = [torch.zeros_like(gained.sum(-1))]
        for decay, added in zip(left.unbind(-1), gained.unbind(-1), strict=True):
            strains.append(decay * strains[-1] + added)
        return torch.stack(strains)

    return delayed((of_y - ratio * of_z) / modulus), delayed((of_z - ratio * of_y) / modulus)


def _step_weights(delay: Tensor) -> tuple[Tensor, Tensor]:
    """Return the weights with which the equilibrium strain (stress over modulus) at the start and at the end of a time
    step adds to the strain at its end, for `delay`, the relaxation rate times the step.

    x is the relaxation rate times the step. They are (1 - exp(-x) (1 + x)) / x and (x - 1 + exp(-x)) / x, both x / 2
    for a small step, without cancellation.
    """
    small = delay < 0.5
    large, reduced = torch.where(small, 1.0, delay), torch.where(small, delay, 0.0)
    late = torch.where(small, _end_weight(reduced), 1 + torch.expm1(-large) / large)
    early = torch.where(small, -torch.exp(-reduced) * _end_weight(-reduced), 1 - torch.exp(-large) - late)
    return early, late


def _end_weight(x: Tensor) -> Tensor:
    """Return the weight with which the equilibrium strain at the end of a time step adds to the strain there, (x - 1 +
    exp(-x)) / x with x the rate times the step, by the series x / 2! - x^2 / 3! + ...
    """
    total = torch.zeros_like(x)
    for k in range(14, 0, -1):
        total = x * (1 / math.factorial(k + 1) - total)
    return total
