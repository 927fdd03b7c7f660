"""Strain energy of all skin in contact, from a displacement field that extends from the points to the contact border.

A growing contact covers skin at its border that has just touched: there the displacement u since the onset is zero. In
a frame, with r the relative radius in the border's ellipse and places z in its unit disc,

    u(x) = (1 - r^2) sum_k c_k P_k(z),

where P_k are the polynomials up to degree 8, and the functions of the sum are made orthonormal on the disc. The
coefficients are independent Gaussian numbers beforehand, of variance t^2 / degree^8: a prior of smoothness, whose scale
t has the largest marginal likelihood (Rasmussen & Williams 2006, equation 5.8). The energy is its mean over the
coefficients given the measured displacements: that of the mean field, and the mean energy of what is left uncertain.
So neither noise nor smoothing biases it.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fingerflow.ops.fields.strain import green_lagrange, stiffness, strain_energy_density, stress_parts
from fingerflow.tracker.contact_border import BORDER_MM, Border

Array = NDArray[np.float64]

_DEGREE = 8  # of P_k
_SMOOTHNESS = 4  # the prior standard deviation of a coefficient falls with this power of its degree
_SCALES = np.logspace(-8, 10, 73)[:, None]  # t^2, mm^2 over mm^2 of noise
_RADII, _ANGLES = 10, 24  # places of the quadrature, exact for the density of polynomials of this degree
_INDEPENDENT_MM = 2.0  # length of border whose place is uncertain independently of the rest
# Displacement, mm, by which tracking errs over the whole contact alike: skin looks different once it touches.
_COMMON_MM = 4e-4
# Two strips along the border, of this width. A field that vanishes at the border has an RMS displacement in the outer
# one of 0.38 times that in the inner one; measured on presses, with the border's error, 0.4 to 0.65.
_STRIP_MM = 0.4
_VANISHING = 0.7
_BORDER_FRAMES = 8  # in which the relative effect of the border is taken as constant: it needs a second fit


class FrameEnergy(NamedTuple):
    """Strain energy of the contact in one frame and its standard deviation, both in mJ per mm of skin depth."""

    energy: float
    deviation: float


class Solid(NamedTuple):
    """Strain measure and elastic constants: Young's modulus in MPa and Poisson's ratio, as in `triangle_strain`."""

    measure: str
    young_modulus_mpa: float
    poisson_ratio: float


class ContactEnergy:
    """Estimator of the strain energy of all skin in contact, from displacements of points since their onset.

    Args:
        solid: strain measure and elastic constants.
        pairs: (K, 2) pairs of the N points whose errors correlate.
        correlation: (K,) of their errors.
        points: N.
    """

    def __init__(
        self, solid: Solid, pairs: NDArray[np.integer], correlation: NDArray[np.floating], points: int
    ) -> None:
        self._solid, self._basis = solid, _Basis()
        self._fitted, self._by_border = 0, 0.0
        inside = (pairs < points).all(1)
        first, second = pairs[inside].T
        both = np.concatenate((first, second)), np.concatenate((second, first))
        self._shared = csr_array((np.tile(correlation[inside], 2), both), shape=(points, points))

    def of_frames(
        self, position: Array, displacement: Array, variance: NDArray[np.floating], counts: NDArray[np.bool_],
        border: Border,
    ) -> Iterator[FrameEnergy]:  # fmt: skip
        """Yield the energy of each of n frames; NaN where displacements do not decrease towards the contact border.

        Errors of neighbours correlate over less than the field can resolve. They act as independent errors whose
        variance is that of a point times the sum of its correlations with all points.

        Args:
            position: (n, N, 2) mm.
            displacement: (n, N, 2) mm.
            variance: (n, N) mm^2 of a displacement component.
            counts: (n, N) points in contact whose displacement counts from their onset.
            border: of these n frames.
        """
        counts = counts & np.isfinite(displacement).all(-1) & (variance > 0)
        of_point = variance * (1 + (self._shared @ counts.T.astype(np.float64)).T)
        depth = border.inside(position)
        for k, (center, axes, angle) in enumerate(zip(*border, strict=True)):
            some = np.flatnonzero(counts[k])
            moved, error = displacement[k, some], of_point[k, some]
            if not _falls_to_border(moved, error, depth[k, some]):
                yield FrameEnergy(np.nan, np.nan)
                continue
            turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
            yield self._energy((position[k, some] - center) @ turn.T, turn, axes, moved, error)

    def _energy(self, along: Array, turn: Array, axes: Array, moved: Array, variance: Array) -> FrameEnergy:
        error = np.sqrt(variance)[:, None]
        weighed = moved / error
        field = _fit(self._basis.at(along / axes) / error, weighed, self._basis.prior)
        energy, forces, left = self._energy_of_field(field, turn, axes)
        mean = energy + np.trace(left)
        # Of a quadratic form of Gaussian numbers, in each of two components.
        by_points = np.sum(forces * (field.covariance @ forces)) + np.sum(left * left.T)
        if self._fitted % _BORDER_FRAMES == 0:
            self._by_border = self._share_of_border(along, turn, axes, weighed, error, mean)
        self._fitted += 1
        by_tracking = 2 * mean * _COMMON_MM / np.sqrt(np.mean(moved**2) + _COMMON_MM**2)
        deviation = np.sqrt(by_points + (self._by_border * mean) ** 2 + by_tracking**2)
        return FrameEnergy(float(mean), float(deviation))

    def _share_of_border(
        self, along: Array, turn: Array, axes: Array, weighed: Array, error: Array, energy: float
    ) -> float:
        """Return the relative change of the energy for a border that lies one standard deviation further out."""
        step = BORDER_MM * np.sqrt(_INDEPENDENT_MM / perimeter(axes[None])[0])
        other = _fit(self._basis.at(along / (axes + step)) / error, weighed, self._basis.prior)
        larger, _, more = self._energy_of_field(other, turn, axes + step)
        return float((larger + np.trace(more)) / energy - 1)

    def _energy_of_field(self, field: "_Field", turn: Array, axes: Array) -> tuple[float, Array, Array]:
        """Return a field's energy, its gradient (K, 2) in the coefficients, and energy matrix times covariance (K, K).

        C is the covariance of the coefficients of a component, and Q that of the energy, a quadratic form in them to
        first order: the trace of Q C is the mean energy of what is left uncertain.
        """
        basis, area = self._basis, np.pi * axes.prod()
        solid = self._solid.young_modulus_mpa, self._solid.poisson_ratio
        slope = basis.gradient @ (turn / axes[:, None])  # (P, K, 2) by x and y
        by_place = np.moveaxis(slope, 1, 2) @ field.coefficients  # (P, 2, 2) [..., direction, component]
        # du/dx by the place now; by the place at onset it is F - 1 with F = (1 - du/dx)^-1, and areas were 1 / det F.
        now = np.eye(2) - by_place.mT
        strain = green_lagrange(torch.from_numpy(np.linalg.inv(now) - np.eye(2)), self._solid.measure)
        weights = area * basis.weights
        energy = float(weights @ (strain_energy_density(strain, *solid).numpy() * np.linalg.det(now)))
        exx, eyy, exy = strain.unbind(-1)
        xx, yy, xy = (weights * one.numpy() for one in stress_parts(exx, eyy, exy, *solid))
        by_x, by_y = slope[..., 0].T, slope[..., 1].T
        forces = np.stack((by_x @ xx + by_y @ xy, by_x @ xy + by_y @ yy), axis=1)
        direct, _, shear = stiffness(*solid)
        # The mean over both components, each with direct x x + shear / 4 y y, where x and y are exchanged.
        form = (direct + shear / 4) * ((by_x * weights) @ by_x.T + (by_y * weights) @ by_y.T)
        return energy, forces, form @ field.covariance


class _Field(NamedTuple):
    coefficients: Array  # (K, 2) mean
    covariance: Array  # (K, K) of each component


def _falls_to_border(moved: Array, variance: Array, depth: Array) -> bool:
    """Return True if displacements (N, 2) mm decrease towards the contact border, within noise.

    `variance` (N,) is in mm^2; `depth` (N,) is the distance in mm of each point from the border, positive inside.
    """
    strips = [(depth >= k * _STRIP_MM) & (depth < (k + 1) * _STRIP_MM) for k in range(2)]
    if not all(one.any() for one in strips):
        return False
    outer, inner = (float(np.mean(moved[one] ** 2)) for one in strips)
    # Twice the deviation of a mean square that is noise alone, of some ten independent numbers, is its mean.
    return outer < _VANISHING**2 * inner + 2 * float(np.mean(variance[strips[0]]))


def _fit(functions: Array, moved: Array, prior: Array) -> _Field:
    """Fit coefficients (K, 2) of the basis functions (N, K) to displacements (N, 2), by Bayesian regression.

    Functions and displacements are divided by the standard deviations of the displacements.

    The noise is as large as stated, or as the residuals if they are larger.
    """
    scaled = functions * prior
    square, turned = np.linalg.eigh(scaled.T @ scaled)
    square, seen = square.clip(0), turned.T @ (scaled.T @ moved)
    shrunk = 1 + _SCALES * square
    rest = (moved**2).sum() - (_SCALES * (seen**2).sum(1) / shrunk).sum(1)
    noise = np.maximum(rest / moved.size, 1)
    likelihood = -moved.size * np.log(noise) - 2 * np.log(shrunk).sum(1) - rest / noise
    best = int(likelihood.argmax())
    root = prior[:, None] * turned
    inverse = _SCALES[best] / shrunk[best]
    return _Field(root @ (inverse[:, None] * seen), noise[best] * (root * inverse) @ root.T)


class _Basis:
    """Orthonormal polynomials on the unit disc that are zero at its border, and quadrature points and weights.

    Attributes:
        prior: (K,) standard deviations of the coefficients, relative to each other.
        weights: (P,) of the places for a mean over the disc.
        gradient: (P, K, 2) of the functions at the places.
    """

    def __init__(self) -> None:
        nodes, shares = np.polynomial.legendre.leggauss(_RADII)  # in the square of the radius
        turns = 2 * np.pi * np.arange(_ANGLES) / _ANGLES
        places = np.sqrt((nodes[:, None, None] + 1) / 2) * np.stack((np.cos(turns), np.sin(turns)), axis=-1)
        self.weights = np.repeat(shares / 2 / _ANGLES, _ANGLES)
        self._powers = np.array([(n - k, k) for n in range(_DEGREE + 1) for k in range(n + 1)])
        places = places.reshape(-1, 2)
        inside, each = self._rims_and_powers(places)
        # Ordered by degree, so that functions of a degree span the same space in every orientation.
        triangular = np.linalg.qr(inside * each * np.sqrt(self.weights)[:, None], mode="r")
        self._mixed = np.linalg.inv(triangular)
        lower = [np.maximum(self._powers - one, 0) for one in np.eye(2, dtype=int)]
        by_place = [
            inside * self._powers[:, k] * self._rims_and_powers(places, lower[k])[1] - 2 * places[:, k, None] * each
            for k in range(2)
        ]
        self.gradient = np.stack([one @ self._mixed for one in by_place], axis=-1)
        self.prior = (self._powers.sum(1) + 2.0) ** -_SMOOTHNESS

    def at(self, places: Array) -> Array:
        """Return the K basis functions (N, K) at N positions (N, 2) in the unit disc."""
        inside, each = self._rims_and_powers(places)
        result: Array = inside * (each @ self._mixed)
        return result

    def _rims_and_powers(self, places: Array, powers: NDArray[np.integer] | None = None) -> tuple[Array, Array]:
        """Return 1 - r^2 (N, 1) and the monomials x^i y^j (N, K) at positions (N, 2) in the unit disc."""
        i, j = (self._powers if powers is None else powers).T
        x, y = (np.vander(one, _DEGREE + 1, increasing=True) for one in places.T)
        return 1 - (places**2).sum(1, keepdims=True), x[:, i] * y[:, j]


def perimeter(semi_axes: Array) -> Array:
    """Return the perimeters (n,) mm of ellipses with semi-axes (n, 2) mm (Ramanujan 1914)."""
    sums, turned = semi_axes.sum(1), semi_axes[:, ::-1]
    result: Array = np.pi * (3 * sums - np.sqrt((3 * semi_axes + turned).prod(1)))
    return result
