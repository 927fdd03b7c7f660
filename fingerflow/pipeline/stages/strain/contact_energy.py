"""Strain energy of all skin in contact, from a displacement field that extends from the points to the contact border.

A growing contact covers skin at its border that has just touched: there the displacement since the onset is zero. The
field vanishes there (`border_field`). The energy is its mean over the field's coefficients given the measured
displacements: that of the mean field, and the mean energy of what is left uncertain. So neither noise nor smoothing
biases it.
"""

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fingerflow.ops.fields.strain import energy_form, stiffness, strain_parts, stress_parts
from fingerflow.pipeline.stages.strain.border_field import BorderFields, BorderFunctions
from fingerflow.tracker.contact_border import Border

Array = NDArray[np.float64]

_RADIUS_MM = 0.012  # standard deviation of the mean radius of a border from `steady_border`, measured on presses
# Displacement, mm, by which tracking errs over the whole contact alike: skin looks different once it touches.
_COMMON_MM = 4e-4
# Smallest standard deviation, mm, of the displacement of a point in the fit. In the frame of its onset a point has by
# definition not moved at all, and its displacement would outweigh that of all other points.
_LEAST_MM = 1e-5
# Two strips along the border, of this width. A field that vanishes at the border has an RMS displacement in the outer
# one of 0.38 times that in the inner one; measured on presses, with the border's error, 0.4 to 0.65.
_STRIP_MM = 0.4
_VANISHING = 0.7
_BORDER_FRAMES = 8  # in which the relative effect of the border is taken as constant: it needs a second fit


class FrameEnergies(NamedTuple):
    """Strain energies (n,) of the contact in n frames and their standard deviations, mJ per mm of skin depth."""

    energy: Array
    deviation: Array


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
        self._solid, self._functions = solid, BorderFunctions()
        self._fitted, self._by_border = 0, 0.0
        inside = (pairs < points).all(1)
        first, second = pairs[inside].T
        both = np.concatenate((first, second)), np.concatenate((second, first))
        self._shared = csr_array((np.tile(correlation[inside], 2), both), shape=(points, points))

    def of_frames(
        self, position: Array, displacement: Array, variance: NDArray[np.floating], counts: NDArray[np.bool_],
        border: Border,
    ) -> FrameEnergies:  # fmt: skip
        """Return the strain energies of the skin in contact in n frames, with standard deviations; NaN where
        displacements do not decrease towards the contact border.

        Errors of neighbours correlate over less than the field can resolve. They act as independent errors whose
        variance is that of a point times the sum of its correlations with all points.

        Args:
            position: (n, N, 2) mm.
            displacement: (n, N, 2) mm.
            variance: (n, N) mm^2 of a displacement component.
            counts: (n, N) points in contact whose displacement counts from their onset.
            border: of these n frames, smoothed over time.
        """
        counts = counts & np.isfinite(displacement[..., 0] + displacement[..., 1]) & np.isfinite(variance)
        of_point = np.maximum(variance, _LEAST_MM**2) * (1 + (self._shared @ counts.T.astype(np.float64)).T)
        result = FrameEnergies(*np.full((2, len(counts)), np.nan))
        some = np.flatnonzero(_fall_to_border(displacement, of_point, border.inside(position), counts))
        if len(some):
            at = np.ix_(some, np.flatnonzero(counts[some].any(0)))
            points = _Points.of(position[at], displacement[at], of_point[at], counts[at], border.at(some))
            result.energy[some], result.deviation[some] = self._energies(points)
        return result

    def _energies(self, points: "_Points") -> FrameEnergies:
        field = self._fit(points)
        energy, forces, left = self._energies_of_fields(field, points)
        mean = energy + np.trace(left, axis1=1, axis2=2)
        # Of a quadratic form of Gaussian numbers, in each of two components.
        by_points = (forces * (field.covariance @ forces)).sum((1, 2)) + (left * left.mT).sum((1, 2))
        size = (points.moved**2).sum((1, 2)) / 2 / (points.weight > 0).sum(1)
        by_tracking = 2 * mean * _COMMON_MM / np.sqrt(size + _COMMON_MM**2)
        by_border = self._shares_of_border(points, mean) * mean
        return FrameEnergies(mean, np.sqrt(by_points + by_border**2 + by_tracking**2))

    def _shares_of_border(self, points: "_Points", energy: Array) -> Array:
        """Return the relative change (n,) of the strain energy in each of n frames if the contact border lay one
        standard deviation of its position further out.

        They are computed in every `_BORDER_FRAMES`-th frame that has a field, and hold until the next.
        """
        some = np.flatnonzero((self._fitted + np.arange(len(energy))) % _BORDER_FRAMES == 0)
        self._fitted += len(energy)
        known = np.array([self._by_border])
        if len(some):
            wider = _Points(*(one[some] for one in points))
            wider = wider._replace(axes=wider.axes + _RADIUS_MM)
            larger, _, more = self._energies_of_fields(self._fit(wider), wider)
            known = np.append(known, (larger + np.trace(more, axis1=1, axis2=2)) / energy[some] - 1)
        self._by_border = float(known[-1])
        result: Array = known[np.searchsorted(some, np.arange(len(energy)), side="right")]
        return result

    def _fit(self, points: "_Points") -> BorderFields:
        return self._functions.fit(points.along / points.axes[..., None], points.moved, points.weight)

    def _energies_of_fields(self, field: BorderFields, points: "_Points") -> tuple[Array, Array, Array]:
        """Return the elastic energies (n,) of displacement fields, their gradients (n, K, 2) in the K fit coefficients,
        and the product (n, K, K) of energy matrix and coefficient covariance, whose trace is the energy that
        uncertainty adds.

        C is the covariance of the coefficients of a component, and Q (n, K, K) that of the energy, a quadratic form in
        them to first order: the trace of Q C is the mean energy of what is left uncertain.
        """
        functions, area = self._functions, np.pi * points.axes.prod(1)
        solid = self._solid.young_modulus_mpa, self._solid.poisson_ratio
        # By the place in the disc, (2, P, n, 2) [direction, ..., component], then by x and y.
        slope = torch.from_numpy(np.tensordot(functions.gradient, field.coefficients, (2, 1)))
        onto = torch.from_numpy(
            (points.turn / points.axes[:, :, None]).transpose(2, 1, 0)
        )  # (2, 2, n) [x or y, direction]
        (ux, vx), (uy, vy) = (
            [slope[0, ..., k] * one + slope[1, ..., k] * other for k in range(2)] for one, other in onto
        )
        # du/dx by the place now; by the place at onset it is F - 1 with F = (1 - du/dx)^-1, and areas were 1 / det F.
        shrunk = (1 - ux) * (1 - vy) - uy * vx
        since = (1 - vy) / shrunk - 1, uy / shrunk, vx / shrunk, (1 - ux) / shrunk - 1
        exx, eyy, exy = strain_parts(*since, self._solid.measure)
        weights = torch.from_numpy(functions.weights[:, None] * area)
        energy = (energy_form(exx * exx, eyy * eyy, exy * exy, exx * eyy, *solid) * shrunk * weights).sum(0).numpy()
        xx, yy, xy = (weights * one for one in stress_parts(exx, eyy, exy, *solid))
        stress = [torch.stack((xx * x + xy * y, xy * x + yy * y)) for x, y in onto.transpose(0, 1)]
        forces = np.tensordot(functions.gradient, torch.stack(stress).numpy(), ((0, 1), (0, 2))).transpose(2, 0, 1)
        direct, _, shear = stiffness(*solid)
        # The mean over both components, each with direct x x + shear / 4 y y, where x and y are exchanged.
        scale = ((direct + shear / 4) * area)[:, None] / points.axes**2
        return energy, forces, np.tensordot(scale, functions.squares, 1) @ field.covariance


class _Points(NamedTuple):
    """Displacements and weights of N points in n frames, with positions along the axes of the ellipse that bounds the
    contact.
    """

    along: Array  # (n, 2, N) mm along the ellipse's axes, from its centre
    moved: Array  # (n, 2, N) mm displacement in x and y
    weight: Array  # (n, N) inverse variance of a displacement component, 1/mm^2; 0 where a point does not count
    axes: Array  # (n, 2) mm, semi-axes
    turn: Array  # (n, 2, 2), from x and y to the axes

    @classmethod
    def of(
        cls, position: Array, displacement: Array, variance: Array, counts: NDArray[np.bool_], border: Border
    ) -> "_Points":
        """Create the points from positions, displacements and the border ellipses of n frames; arguments are as for
        `ContactEnergy.of_frames`.
        """
        cosine, sine = np.cos(border.angle), np.sin(border.angle)
        turn = np.stack((cosine, sine, -sine, cosine), axis=-1).reshape(-1, 2, 2)
        from_centre, moved = (
            np.ascontiguousarray(np.where(counts[..., None], one, 0.0).mT)
            for one in (position - border.center[:, None], displacement)
        )
        weight = np.where(counts, 1 / np.where(counts, variance, 1), 0.0)
        return cls(turn @ from_centre, moved, weight, border.semi_axes, turn)


def _fall_to_border(moved: Array, variance: Array, depth: Array, counts: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask (n,) of frames in which displacements (n, N, 2) mm decrease towards the border, within noise.

    `variance` (n, N) is in mm^2; `depth` (n, N) is the distance in mm of each point from the border, positive inside;
    `counts` (n, N) is True for points that are known.
    """
    strips = [counts & (depth >= k * _STRIP_MM) & (depth < (k + 1) * _STRIP_MM) for k in range(2)]

    def mean(values: Array, strip: NDArray[np.bool_]) -> Array:
        result: Array = np.where(strip, values, 0).sum(1) / np.maximum(strip.sum(1), 1)
        return result

    square = (moved[..., 0] ** 2 + moved[..., 1] ** 2) / 2
    outer, inner = (mean(square, one) for one in strips)
    # Twice the deviation of a mean square that is noise alone, of some ten independent numbers, is its mean.
    fall = outer < _VANISHING**2 * inner + 2 * mean(variance, strips[0])
    result: NDArray[np.bool_] = fall & strips[0].any(1) & strips[1].any(1)
    return result


def perimeter(semi_axes: Array) -> Array:
    """Return the perimeters (n,) mm of ellipses with semi-axes (n, 2) mm (Ramanujan 1914)."""
    sums, turned = semi_axes.sum(1), semi_axes[:, ::-1]
    result: Array = np.pi * (3 * sums - np.sqrt((3 * semi_axes + turned).prod(1)))
    return result
