"""The cubic B-spline around a centre as a product of constants with few functions of the shift.

A table of the whole places -r - 1 to r + 1 serves every shift s in (-r, r). With the four truncated powers of the
B-spline, b3(x) = sum_j (-1)^j C(4, j) max(x + 2 - j, 0)^3 / 6, all weights are combinations of 1, s, s^2, s^3 and
max(s - k, 0)^3 for the knots k = 1 - r to r - 1 inside: five functions for a reach of 1 px, seven for 2.
"""

from math import comb

import torch
from torch import Tensor


def taps(reach: int) -> int:
    """Places of a table, and functions."""
    return 2 * reach + 3


def spline_matrix(reach: int, precision: torch.dtype) -> Tensor:
    """(places, functions), both 2 reach + 3: weight of place k - reach - 1 is row k times `features`."""
    matrix = torch.zeros(taps(reach), taps(reach), dtype=torch.float64)
    for row in range(taps(reach)):
        for j in range(5):
            knot = (row - reach - 1) - 2 + j  # max(s - knot, 0)^3
            factor = (-1) ** j * comb(4, j) / 6
            if knot <= -reach:  # never negative: a polynomial
                polynomial = torch.tensor([-(knot**3), 3 * knot**2, -3 * knot, 1], dtype=torch.float64)
                matrix[row, :4] += factor * polynomial
            elif knot < reach:
                matrix[row, 4 + knot + reach - 1] += factor
    return matrix.to(precision)


def smoothed_spline_matrix(reach: int, precision: torch.dtype) -> Tensor:
    """(2 reach + 5, functions): the same for pixels in place of coefficients, which are pixels under [1 2 1] / 4."""
    matrix = spline_matrix(reach, torch.float64)
    spread = torch.zeros(taps(reach) + 2, taps(reach), dtype=torch.float64)
    for offset, weight in enumerate((0.25, 0.5, 0.25)):
        spread[offset : offset + taps(reach)] += weight * matrix
    return spread.to(precision)


def features(shift: Tensor, reach: int) -> Tensor:
    """(2 reach + 3, ...) of shifts (...)."""
    square = shift * shift
    cube = square * shift
    # The cube keeps the sign: one operation where the knot is 0.
    beyond = [(_cube(shift - knot) if knot else cube).clamp_min(0) for knot in range(1 - reach, reach)]
    return torch.stack((torch.ones_like(shift), shift, square, cube, *beyond))


def _cube(values: Tensor) -> Tensor:
    return values * values * values


def feature_slopes(shift: Tensor, reach: int) -> Tensor:
    """Their derivatives (2 reach + 3, ...)."""
    beyond = [(shift - knot if knot else shift).clamp_min(0) for knot in range(1 - reach, reach)]
    slopes = (torch.zeros_like(shift), torch.ones_like(shift), 2 * shift, 3 * (shift * shift))
    return torch.stack((*slopes, *(3 * (x * x) for x in beyond)))


def feature_bends(shift: Tensor, reach: int) -> Tensor:
    """Their second derivatives (2 reach + 3, ...)."""
    beyond = [(shift - knot).clamp_min(0) for knot in range(1 - reach, reach)]
    nothing = torch.zeros_like(shift)
    return torch.stack((nothing, nothing, 2 + nothing, 6 * shift, *(6 * x for x in beyond)))
