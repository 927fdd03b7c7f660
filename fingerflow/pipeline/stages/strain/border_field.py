"""Displacement fields in the contact ellipse, fitted to displacements of points by Bayesian regression.

With r the relative radius in the border's ellipse and places z in its unit disc, a field that vanishes at the border is

    u(x) = (1 - r^2) sum_k c_k P_k(z),

where P_k are the polynomials up to degree 8, and the functions of the sum are made orthonormal on the disc. The
coefficients are independent Gaussian numbers beforehand, of variance t^2 / degree^8: a prior of smoothness, whose scale
t is its posterior root mean square, by its marginal likelihood (Rasmussen & Williams 2006, equation 5.8) and a uniform
prior of t (Gelman 2006). Where noise hides a displacement, the most likely scale would be 0.

A field that moves at the border has, in addition, the harmonic polynomials r^m cos(m a) and r^m sin(m a), m up to 4,
of the angle a. At the border these are a Fourier series of the displacement. Their coefficients have a prior standard
deviation of s / (1 + m), where s is the RMS displacement of the outermost points.

Products of two polynomials are polynomials, so that the normal equations of all K (K + 1) / 2 pairs of functions come
from 17^2 moments of the points. That takes a third of the operations of summing each pair over 500 points.
"""

from typing import NamedTuple

import numpy as np
import torch
from numpy.polynomial.polynomial import polyvander
from scipy.special import comb

from fingerflow.kernels.array_types import Array, Numbers

_DEGREE = 8  # degree of the polynomials P_k
_SMOOTHNESS = 4  # the prior standard deviation of a coefficient falls with this power of its degree
_SCALES = 10 ** (np.arange(54) / 4 - 8)  # mm^2, candidates for t^2
# A share of the largest sum that keeps the normal equations positive definite also where the prior is wide: rounding
# changes their eigenvalues by up to 8e-16 of that sum (3 to 550 points, weights that differ by up to 1e6).
_ROUNDING = 1e-14
_HARMONICS = 4  # highest order m of the displacement along the border
_TOGETHER = 8  # number of frames for whose points a processor's cache holds all powers
# Numbers of radii and angles of the quadrature, which is exact for the energy density of polynomials of this degree.
_RADII, _ANGLES = 10, 24


class BorderFields(NamedTuple):
    """Coefficients of n displacement fields in the first K functions of `BorderFunctions`: mean, covariance, and how
    well the fields explain the displacements.
    """

    coefficients: Array  # (n, K, 2) mean of the coefficients
    covariance: Array  # (n, K, K) covariance of the coefficients of each component
    noise: Array  # (n,) variance of the residuals relative to the stated one, at least 1
    evidence: Array  # (n,) twice the logarithm of the marginal likelihood, up to a constant of the data


class BorderFunctions:
    """Polynomials in x and y on the unit disc, with the points and weights of a numerical integration over the disc:
    those that are zero at its border, then the harmonic ones.

    The former are orthonormal but for a factor: the standard deviation of the coefficient beforehand, in units of t.
    The harmonic ones have theirs in units of s.

    Attributes:
        places: (P, 2) in the unit disc.
        weights: (P,) of the places for a mean over the disc.
        gradient: (2, P, K) of the functions at the places.
        squares: (2, K, K) means over the disc of products of two functions' derivatives in the same direction.
    """

    def __init__(self) -> None:
        nodes, shares = np.polynomial.legendre.leggauss(_RADII)  # nodes in the square of the radius
        turns = 2 * np.pi * np.arange(_ANGLES) / _ANGLES
        positions = np.sqrt((nodes[:, None] + 1) / 2)[..., None] * np.stack((np.cos(turns), np.sin(turns)), axis=-1)
        self.places = positions.reshape(-1, 2)
        self.weights = np.repeat(shares / 2 / _ANGLES, _ANGLES)
        i, j = self._powers = np.array([(n - k, k) for n in range(_DEGREE + 1) for k in range(n + 1)]).T
        x, y = self.places.T[:, None]
        inside = (1 - x**2 - y**2)[0, :, None]
        x_powers, y_powers = (polyvander(coordinate[0], _DEGREE) for coordinate in (x, y))
        each = x_powers[:, i] * y_powers[:, j]
        # Orthogonalise in the order of the degrees, so that functions of a degree span the same space in every
        # orientation.
        triangular = np.linalg.qr(inside * each * np.sqrt(self.weights)[:, None], mode="r")
        self._mixed = np.linalg.inv(triangular) * (i + j + 2.0) ** -_SMOOTHNESS
        by_x = i * x_powers[:, np.maximum(i - 1, 0)] * y_powers[:, j]
        by_y = j * x_powers[:, i] * y_powers[:, np.maximum(j - 1, 0)]
        slopes = np.stack((inside * by_x - 2 * x.T * each, inside * by_y - 2 * y.T * each))
        # The harmonic polynomials, real and imaginary parts of (x + iy)^m over 1 + m, in the monomials x^i y^j.
        orders, (degree, of_y) = np.arange(_HARMONICS + 1), np.stack((i + j, j))[..., None]
        powers = np.where(degree == orders, comb(orders, of_y) * 1j**of_y, 0) / (1 + orders)
        self._harmonics = np.delete(powers.view(np.float64), 1, axis=1)  # order 0 has no imaginary part
        self.gradient = np.concatenate((slopes @ self._mixed, np.stack((by_x, by_y)) @ self._harmonics), axis=2)
        self.squares = (self.gradient * self.weights[:, None]).mT @ self.gradient

    def fit(self, positions: Array, moved: Array, weight: Array, at_border: Array | None = None) -> BorderFields:
        """Fit the polynomial coefficients of n displacement fields, each to the displacements of N points, by Bayesian
        least squares.

        The noise is as large as stated, or as the residuals if they are larger.

        Args:
            positions: (n, 2, N) in the unit disc; finite.
            moved: (n, 2, N) mm; finite.
            weight: (n, N) inverse variance of a displacement component, 1/mm^2; 0 for points that are not known.
            at_border: (n,) mm, prior standard deviation s of the displacement at the border; without it the fields
                vanish there.
        """
        free = at_border is not None
        runs = [slice(first, first + _TOGETHER) for first in range(0, len(positions), _TOGETHER)]
        normal = np.concatenate([self._normal_equations(positions[k], moved[k], weight[k], free) for k in runs])
        smooth, functions = len(self._mixed), normal.shape[1] - 2
        # Harmonic functions in units of s, so that the prior of their coefficients is 1.
        at_border = np.ones(1) if at_border is None else at_border
        units = np.where(np.arange(functions) < smooth, 1.0, at_border[:, None])[..., None]
        normal[:, :functions] *= units
        normal[:, :, :functions] *= units.mT
        noise, evidence = _find_scales(normal, 2 * (weight > 0).sum(1), smooth)
        inverse = units * torch.linalg.inv(torch.from_numpy(normal[:, :functions, :functions])).numpy() * units.mT
        coefficients = inverse @ (normal[:, :functions, functions:] / units)
        return BorderFields(coefficients, noise[:, None, None] * inverse, noise, evidence)

    def _normal_equations(self, positions: Array, moved: Array, weight: Array, harmonic: bool) -> Array:
        """Return the normal equations (n, K + 2, K + 2) of the fits: weighted sums over the points of products of the K
        polynomials, with or without the harmonic ones, and the two displacement components.
        """
        i, j = self._powers
        x, y = (polyvander(positions[:, k], 2 * _DEGREE).mT for k in range(2))  # (n, powers, N)
        inside = 1 - x[:, 2] - y[:, 2]

        def sum_pairs(weights: Array) -> Array:
            pairs = (x * weights[:, None]) @ y.mT
            return pairs.reshape(len(pairs), -1).take((i[:, None] + i) * x.shape[1] + j[:, None] + j, axis=1)

        def sum_moved(weighed: Array) -> Array:
            # Multiply each component by each power of x, and the result by each power of y.
            low = x[:, None, : _DEGREE + 1] * weighed[:, :, None]
            return (low @ y[:, None, : _DEGREE + 1].mT)[:, :, i, j]

        weighed = moved * weight[:, None]
        smooth, functions = len(self._mixed), len(self._mixed) + harmonic * self._harmonics.shape[1]
        result = np.empty((len(positions), functions + 2, functions + 2))
        result[:, :smooth, :smooth] = self._mixed.T @ sum_pairs(weight * inside**2) @ self._mixed
        result[:, functions:, :smooth] = sum_moved(weighed * inside[:, None]) @ self._mixed
        if harmonic:
            result[:, smooth:functions, smooth:functions] = self._harmonics.T @ sum_pairs(weight) @ self._harmonics
            result[:, smooth:functions, :smooth] = self._harmonics.T @ sum_pairs(weight * inside) @ self._mixed
            result[:, :smooth, smooth:functions] = result[:, smooth:functions, :smooth].mT
            result[:, functions:, smooth:functions] = sum_moved(weighed) @ self._harmonics
        result[:, :functions, functions:] = result[:, functions:, :functions].mT
        result[:, functions:, functions:] = weighed @ moved.mT
        return result


def _find_scales(normal: Array, numbers: Numbers, smooth: int) -> tuple[Array, Array]:
    """Compute the prior standard deviation t of the first `smooth` coefficients in each of n fits, its posterior root
    mean square, and add 1 / t^2 (1 for the other coefficients) to the normal equations in place.

    Return the noise variance (n,) relative to the stated one and twice the log-likelihood (n,), up to a constant, both
    at the most likely scale.

    The equations of the first coefficients, given the best others, are diagonal in their eigenvectors for every t.
    """
    functions = normal.shape[1] - 2
    diagonal = np.einsum("nkk->nk", normal)
    diagonal[:, :functions] += _ROUNDING * diagonal[:, :functions].max(1, keepdims=True)
    diagonal[:, smooth:functions] += 1
    kept = np.r_[:smooth, functions : functions + 2]
    others, mixed = normal[:, smooth:functions, smooth:functions], normal[:, smooth:functions, kept]
    left = normal[:, kept[:, None], kept] - mixed.mT @ np.linalg.solve(others, mixed)
    # By torch, in two thirds of the time that NumPy takes for matrices of this size.
    squares, turned = (part.numpy() for part in torch.linalg.eigh(torch.from_numpy(left[:, :smooth, :smooth])))
    seen = ((turned.mT @ left[:, :smooth, smooth:]) ** 2).sum(2)
    scales = _SCALES[:, None, None]
    shrunk = 1 + scales * squares.clip(0)  # (scales, n, smooth)
    rest = (np.trace(left[:, smooth:, smooth:], axis1=1, axis2=2) - (scales * seen / shrunk).sum(2)) / numbers
    noise = np.maximum(rest, 1)
    determinant = np.log(shrunk).sum(2) + np.linalg.slogdet(others)[1]
    likelihood = -numbers * (np.log(noise) + rest / noise) - 2 * determinant
    best = likelihood.argmax(0), np.arange(len(normal))
    odds = np.sqrt(_SCALES)[:, None] * np.exp((likelihood - likelihood[best]) / 2)
    diagonal[:, :smooth] += (odds.sum(0) / (_SCALES @ odds))[:, None]
    return noise[best], likelihood[best]
