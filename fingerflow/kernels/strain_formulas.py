"""Formulas of strain on the separate components of displacement gradients, for NumPy arrays and tensors alike.

The elements of a gradient are du/dx, du/dy, dv/dx and dv/dy. Its covariance (..., 2, 2, 2, 2) has [..., i, j, k, l] =
cov(d u_i / d x_j, d u_k / d x_l).
"""

from typing import Any

from fingerflow.kernels.field_limits import STRAIN_MEASURES

Values = Any  # NumPy array, or torch tensor


def check_measure(measure: str) -> None:
    """Raise ValueError if there is no such strain measure."""
    if measure not in STRAIN_MEASURES:
        raise ValueError(f"strain measure {measure!r} is not known: choose one of {', '.join(STRAIN_MEASURES)}")


def strain_parts(ux: Values, uy: Values, vx: Values, vy: Values, measure: str) -> tuple[Values, Values, Values]:
    """Return the strain components exx, eyy and exy of a displacement gradient; see `ops.green_lagrange`."""
    check_measure(measure)
    exx, eyy, exy = ux, vy, (uy + vx) / 2
    if measure != "infinitesimal":
        exx = exx + (ux * ux + vx * vx) / 2
        eyy = eyy + (uy * uy + vy * vy) / 2
    if measure == "green_lagrange":
        exy = exy + (ux * uy + vx * vy) / 2
    return exx, eyy, exy


def sensitivity_parts(
    ux: Values, uy: Values, vx: Values, vy: Values, measure: str, none: Values = 0.0, unit: Values = 1.0
) -> list[Values]:
    """Return the derivatives of divergence, curl, exx, eyy and exy with respect to the elements du/dx, du/dy, dv/dx and
    dv/dy of a displacement gradient: 20 parts, four of each field in turn; those that are constant are `none` or +-
    `unit`, or half of it.
    """
    check_measure(measure)
    # Derivatives of e_ij = (F_ki F_kj - delta_ij) / 2 with F = I + gradient; for infinitesimal strain F is I.
    identity, moved = (unit, none, none, unit), (1 + ux, uy, vx, 1 + vy)
    xx, xy, yx, yy = identity if measure == "infinitesimal" else moved
    divergence, curl = (unit, none, none, unit), (none, -unit, unit, none)
    exx, eyy = (xx, none, yx, none), (none, xy, none, yy)
    xx, xy, yx, yy = (part / 2 for part in (moved if measure == "green_lagrange" else identity))
    return [*divergence, *curl, *exx, *eyy, xy, xx, yy, yx]


def divergence_variance(covariance: Values) -> Values:
    """Return the variance (...) of the divergence du/dx + dv/dy."""
    ux, vy = covariance[..., 0, 0, :, :], covariance[..., 1, 1, :, :]
    return ux[..., 0, 0] + ux[..., 1, 1] + vy[..., 0, 0] + vy[..., 1, 1]


def curl_variance(covariance: Values) -> Values:
    """Return the variance (...) of the curl dv/dx - du/dy, in rad^2."""
    uy, vx = covariance[..., 0, 1, :, :], covariance[..., 1, 0, :, :]
    return vx[..., 1, 0] - vx[..., 0, 1] - uy[..., 1, 0] + uy[..., 0, 1]
