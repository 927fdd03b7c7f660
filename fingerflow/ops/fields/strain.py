"""Divergence, curl, shear, strain, stress and strain energy of a displacement gradient.

A gradient (..., 2, 2) has [..., i, j] = d u_i / d x_j with (u, v) and (x, y), without unit, in REFERENCE coordinates. A
strain (..., 3) is (exx, eyy, exy) with the tensor's exy, half of the engineering shear. Results have the dtype of the
input, and NaN propagates.
"""

import math

import torch
from torch import Tensor

from fingerflow.kernels.field_limits import STRAIN_MEASURES
from fingerflow.ops.tensors import half_angle, hypotenuse


def divergence(gradient: Tensor) -> Tensor:
    """Return the divergence du/dx + dv/dy (...), without unit: the relative growth of area to first order.

    Source: Willemet et al. 2021, figure S6. No compiled twin.

    Convention:
        axes: gradient[..., i, j] = d u_i / d x_j, x to the right, y down.
        sign: positive where area grows.
        pixel centre: not used.
        dtype: that of the input.
        NaN: in an element, makes that element NaN.
        border: none, each element stands alone.
    """
    ux, _, _, vy = _parts(gradient)
    return ux + vy


def curl(gradient: Tensor) -> Tensor:
    """Return the curl dv/dx - du/dy (...), in rad: twice the rotation angle if small, positive from x towards y.

    Source: Willemet et al. 2021, figure S6. No compiled twin.

    Convention:
        axes: gradient[..., i, j] = d u_i / d x_j, x to the right, y down.
        sign: positive for a rotation from x towards y, clockwise in the picture.
        pixel centre: not used.
        dtype: that of the input.
        NaN: in an element, makes that element NaN.
        border: none, each element stands alone.
    """
    _, uy, vx, _ = _parts(gradient)
    return vx - uy


def shear(gradient: Tensor) -> Tensor:
    """Return the two shear components (..., 2), du/dx - dv/dy and du/dy + dv/dx, without unit.

    They are s = du/dx - dv/dy along the axes and t = du/dy + dv/dx along the diagonals. With divergence d and curl c
    the gradient is [[d + s, t - c], [t + c, d - s]] / 2 (Willemet et al. 2021, figure S6).
    """
    ux, uy, vx, vy = _parts(gradient)
    return torch.stack((ux - vy, uy + vx), dim=-1)


def green_lagrange(gradient: Tensor, measure: str = "green_lagrange") -> Tensor:
    """Return the strain (exx, eyy, exy) of a displacement gradient (..., 2, 2), by default the Green-Lagrange strain.

    The lab's published script has dv/dx instead of dv/dy in eyy; here it is dv/dy. `measure` is one of
    - "green_lagrange": (F'F - I) / 2 with F = I + gradient; zero for every rotation.
    - "as_printed": the same except exy = (u_y + v_x) / 2, as in equation 1 of Willemet et al. 2021. It lacks (u_x u_y +
      v_x v_y) / 2, so a stretch that is also rotated gets a spurious shear.
    - "infinitesimal": the symmetric part of the gradient; a rotation by w appears as a stretch of -w^2 / 2.

    Raises:
        ValueError: another measure, or a wrong dtype or shape.

    Source: Willemet et al. 2021, equation 1, and (F'F - I) / 2 of continuum mechanics. No compiled twin.

    Convention:
        axes: gradient[..., i, j] = d u_i / d x_j, x to the right, y down; the result is (..., 3), exx, eyy, exy.
        sign: positive for stretch; exy is positive where the right angle from x to y closes.
        pixel centre: not used.
        dtype: that of the input.
        NaN: in an element, makes the components of that element that depend on it NaN.
        border: none, each element stands alone.
    """
    return torch.stack(strain_parts(*_parts(gradient), measure), dim=-1)


def principal_strains(strain: Tensor) -> tuple[Tensor, Tensor]:
    """Return the major and minor principal strain (..., 2) of a strain tensor (exx, eyy, exy), (..., 3), which are the
    largest and the smallest normal strain over all directions, and the angle (...) from the x axis to the major
    direction, rad in [-pi/2, pi/2].

    Where the two are equal, the direction is undefined and the angle NaN. Their difference has a kink there, so
    autograd gives both the gradient of their mean.
    """
    exx, eyy, exy = _components(strain)
    mean, half_difference = (exx + eyy) / 2, (exx - eyy) / 2
    equal = (half_difference == 0) & (exy == 0)
    # Replace the arguments beforehand, since hypot and atan2 have NaN derivatives at the origin.
    half_difference, exy = torch.where(equal, 1, half_difference), torch.where(equal, 0, exy)
    radius = torch.where(equal, 0, hypotenuse(half_difference, exy))
    angle = torch.where(equal, torch.nan, half_angle(exy, half_difference))
    return torch.stack((mean + radius, mean - radius), dim=-1), angle


def principal_deviations(strain: Tensor, std: Tensor) -> tuple[Tensor, Tensor]:
    """Return the standard deviations of the principal strains (..., 2) and of the angle (...) of the major one, rad.
    The components of the strain (..., 3) have independent errors with the standard deviations `std` (..., 3).

    Where the principal strains differ by less than their errors, the angle is that of any direction, whose deviation is
    pi / sqrt(12).
    """
    principal, angle = principal_strains(strain)
    xx, yy, xy = _components(std * std)
    twice = 2 * torch.where(angle.isnan(), 0, angle)
    along, across = (1 + torch.cos(twice)) / 2, (1 - torch.cos(twice)) / 2
    mixed = torch.sin(twice) ** 2
    variances = [one**2 * xx + other**2 * yy + mixed * xy for one, other in ((along, across), (across, along))]
    turned = mixed * (xx + yy) / 4 + torch.cos(twice) ** 2 * xy
    difference = principal[..., 0] - principal[..., 1]
    angle_std = (12 / math.pi**2 + difference * difference / turned).rsqrt()
    return torch.stack(variances, dim=-1).sqrt(), torch.where(angle.isnan(), angle, angle_std)


def strain_energy_density(strain: Tensor, young_modulus_mpa: float = 1.0, poisson_ratio: float = 0.4) -> Tensor:
    """Return the elastic energy density (...), mJ/mm^3, of an isotropic linear solid in plane strain.

    For strain (..., 3) it is E(1-nu)/(2(1+nu)(1-2nu)) (exx^2 + eyy^2) + E nu/((1+nu)(1-2nu)) exx eyy + E/(1+nu) exy^2
    (Willemet et al. 2021). Its derivatives are the stresses sxx, syy and 2 sxy in MPa, as 1 MPa = 1 mJ/mm^3. It is
    positive for every strain but zero. float16 underflows below 6e-8 mJ/mm^3, a strain of 3e-4 at 1 MPa: use bfloat16
    or float32.

    Raises:
        ValueError: not young_modulus_mpa > 0 or not -1 < poisson_ratio < 0.5: outside, the energy is not positive.

    Source: Willemet et al. 2021, strain energy. No compiled twin.

    Convention:
        axes: strain (..., 3) is exx, eyy, exy, x to the right, y down.
        sign: never negative.
        pixel centre: not used.
        dtype: that of the input.
        NaN: in an element, makes that element NaN.
        border: none, each element stands alone.
    """
    if not (math.isfinite(young_modulus_mpa) and young_modulus_mpa > 0):
        raise ValueError(f"young_modulus_mpa must be a positive number of MPa, found {young_modulus_mpa}")
    if not -1 < poisson_ratio < 0.5:
        raise ValueError(
            f"poisson_ratio must lie between -1 and 0.5, both excluded, found {poisson_ratio}; "
            "for a nearly incompressible skin take a value such as 0.49"
        )
    exx, eyy, exy = _components(strain)
    return energy_form(exx * exx, eyy * eyy, exy * exy, exx * eyy, young_modulus_mpa, poisson_ratio)


def strain_energy_density_std(strain: Tensor, std: Tensor, young_modulus_mpa: float, poisson_ratio: float) -> Tensor:
    """Return the root mean square error (...), mJ/mm^3, of the strain energy density by independent errors, of
    standard deviations `std`, of the measured strain (..., 3): to second order, with what errors add on average.

    The measured stress has errors too, which add twice the second order to the first on average.
    """
    solid, (xx, yy, xy) = (young_modulus_mpa, poisson_ratio), _components(std * std)
    direct, mixed, shear = stiffness(*solid)
    sxx, syy, sxy = stress_parts(*_components(strain), *solid)
    first = sxx * sxx * xx + syy * syy * yy + 4 * sxy * sxy * xy
    second = 2 * (direct * direct * (xx * xx + yy * yy) + shear * shear * xy * xy) + mixed * mixed * xx * yy
    return (torch.maximum(first - second, second) + energy_form(xx, yy, xy, 0 * xx, *solid) ** 2).sqrt()


def stress_parts(
    exx: Tensor, eyy: Tensor, exy: Tensor, young_modulus_mpa: float, poisson_ratio: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the stress components sxx, syy and sxy, MPa, of an isotropic linear solid in plane strain."""
    direct, mixed, shear = stiffness(young_modulus_mpa, poisson_ratio)
    return 2 * direct * exx + mixed * eyy, 2 * direct * eyy + mixed * exx, shear * exy


def energy_form(
    xx: Tensor, yy: Tensor, xy: Tensor, between: Tensor, young_modulus_mpa: float, poisson_ratio: float
) -> Tensor:
    """Return the strain energy density, mJ/mm^3, of an isotropic linear solid in plane strain, from the products exx^2,
    eyy^2, exy^2 and exx eyy (`xx`, `yy`, `xy`, `between`) of strain components, or their means.
    """
    direct, mixed, shear = stiffness(young_modulus_mpa, poisson_ratio)
    return direct * (xx + yy) + mixed * between + shear * xy


def stiffness(young_modulus_mpa: float, poisson_ratio: float) -> tuple[float, float, float]:
    """Return the coefficients of exx^2 + eyy^2, exx eyy and exy^2 in the strain energy density, MPa."""
    scale = young_modulus_mpa / (1 + poisson_ratio)
    direct = scale * (1 - poisson_ratio) / (2 * (1 - 2 * poisson_ratio))
    return direct, scale * poisson_ratio / (1 - 2 * poisson_ratio), scale


def check_measure(measure: str) -> None:
    """Raise ValueError if there is no such strain measure."""
    if measure not in STRAIN_MEASURES:
        raise ValueError(f"strain measure {measure!r} is not known: choose one of {', '.join(STRAIN_MEASURES)}")


def strain_parts(ux: Tensor, uy: Tensor, vx: Tensor, vy: Tensor, measure: str) -> tuple[Tensor, Tensor, Tensor]:
    """Return the strain components exx, eyy and exy of a displacement gradient; see `green_lagrange`."""
    check_measure(measure)
    exx, eyy, exy = ux, vy, (uy + vx) / 2
    if measure != "infinitesimal":
        exx = exx + (ux * ux + vx * vx) / 2
        eyy = eyy + (uy * uy + vy * vy) / 2
    if measure == "green_lagrange":
        exy = exy + (ux * uy + vx * vy) / 2
    return exx, eyy, exy


def sensitivity_parts(ux: Tensor, uy: Tensor, vx: Tensor, vy: Tensor, measure: str) -> list[Tensor]:
    """Return the derivatives of divergence, curl, exx, eyy and exy with respect to the elements du/dx, du/dy, dv/dx and
    dv/dy of a displacement gradient: 20 parts, four of each field in turn.
    """
    check_measure(measure)
    none, unit = torch.zeros_like(ux), torch.ones_like(ux)
    # Derivatives of e_ij = (F_ki F_kj - delta_ij) / 2 with F = I + gradient; for infinitesimal strain F is I.
    identity, moved = (unit, none, none, unit), (1 + ux, uy, vx, 1 + vy)
    xx, xy, yx, yy = identity if measure == "infinitesimal" else moved
    divergence, curl = (unit, none, none, unit), (none, -unit, unit, none)
    exx, eyy = (xx, none, yx, none), (none, xy, none, yy)
    xx, xy, yx, yy = (part / 2 for part in (moved if measure == "green_lagrange" else identity))
    return [*divergence, *curl, *exx, *eyy, xy, xx, yy, yx]


def _parts(gradient: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return the elements du/dx, du/dy, dv/dx and dv/dy of a displacement gradient (..., 2, 2)."""
    if not gradient.is_floating_point() or gradient.shape[-2:] != (2, 2):
        raise ValueError(f"gradient must be floating (..., 2, 2), found {gradient.dtype} {tuple(gradient.shape)}")
    return gradient[..., 0, 0], gradient[..., 0, 1], gradient[..., 1, 0], gradient[..., 1, 1]


def _components(strain: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    if not strain.is_floating_point() or strain.shape[-1:] != (3,):
        raise ValueError(f"strain must be floating (..., 3), exx, eyy, exy, found {strain.dtype} {tuple(strain.shape)}")
    return strain[..., 0], strain[..., 1], strain[..., 2]
