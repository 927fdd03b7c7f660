"""Cubic B-splines on an evenly spaced grid, for evaluation at every pixel."""

from torch import Tensor


def cubic_weights(t: Tensor) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """Return the weights of the four coefficients of a cubic B-spline around a point at a fraction t (0 to 1) between
    two grid points, and the derivatives of the weights by t.
    """
    s = 1 - t
    values = s**3 / 6, 2 / 3 - t * t * (1 + s) / 2, 2 / 3 - s * s * (1 + t) / 2, t**3 / 6
    slopes = -s * s / 2, t * (3 * t - 4) / 2, s * (4 - 3 * s) / 2, t * t / 2
    return values, slopes
