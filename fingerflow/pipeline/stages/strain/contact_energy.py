"""Strain energy of all skin in contact, from a displacement field that extends from the points to the contact border.

A growing contact covers skin at its border that has just touched: there the displacement since the onset is zero, and
so is the field (`border_field`). Where the border has stopped or retreats, the skin at it has touched before and may
have moved since. Such a field is free at the border. It is used where a field that vanishes there leaves residuals
larger than the errors of the displacements, and is less likely by its marginal likelihood.

The energy is its mean over the field's coefficients given the measured displacements: that of the mean field, and the
mean energy of what is left uncertain. So neither noise nor smoothing biases it.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.spatial.distance import cdist
from scipy.special import ellipe

from fingerflow.kernels.array_types import Array, Mask, Numbers
from fingerflow.kernels.result_records import FrameEllipse
from fingerflow.ops.fields.strain import energy_form, stiffness, strain_parts, stress_parts
from fingerflow.pipeline.stages.strain.border_field import BorderFields, BorderFunctions

# Half of the standard deviation of the mean radius of a border from `steady_border`, measured on presses: where a
# border is too far out, onsets are as early, so that displacements vanish there, too.
_RADIUS_MM = 0.006
# Displacement, mm, by which tracking errs over the whole contact alike: skin looks different once it touches.
_COMMON_MM = 4e-4
# Smallest standard deviation, mm, of the displacement of a point in the fit. In the frame of its onset a point has by
# definition not moved at all, and its displacement would outweigh that of all other points.
_LEAST_MM = 1e-5
_OUTER_MM = 0.4  # width of the strip along the border that shows how skin at the border has moved
GROWTH_MM = 0.04  # growth of the border's mean radius that shows beside its error
# Motion of that strip during this growth, relative to its displacement since the onset, above which the border lags
# behind the skin. A field that vanishes at an advancing border is linear beside it, and has 2 GROWTH_MM / _OUTER_MM;
# what is above moves the border's position by no more than its deviation.
_LAG = 0.25
_DECISIVE = 100.0  # difference of the evidence; it is -70 to 40 while the border advances, and 300 to 7,000 after
# Variance of the residuals, relative to the stated one, above which smooth fields begin not to fit: skin slips. From
# twice as much on none fits.
_UNKNOWN = 4.0
_MISFIT = 5e-3  # residuals, relative to the RMS displacement, by which polynomials of this degree miss smooth fields
_BORDER_FRAMES = 8  # in which the relative effect of the border is taken as constant: it needs a second fit
_FAR_MM = 0.6  # distance from all points beyond which a field is extrapolated


class FrameEnergies(NamedTuple):
    """Strain energies (n,) of the contact in n frames and their standard deviations, mJ per mm of skin depth, whether
    the skin at the border has moved since its onset, and the trust in these energies: 1 where residuals are errors of
    the displacements, falling to 0 where they are so large that no smooth field explains them.
    """

    energy: Array
    deviation: Array
    moves: Mask
    trust: Array


class ContactEnergy:
    """Estimator of the strain energy of all skin in contact, from displacements of points since their onset.

    Args:
        measure: of strain.
        elastic: Young's modulus in MPa and Poisson's ratio, as in `triangle_strain`.
        shared: (N, N) correlations of the errors of the points; dense, or sparse of SciPy.
        faint_mm: by which the border may lie further out, and displacements be short, as the rim is faint.
    """

    def __init__(self, measure: str, elastic: tuple[float, float], shared: Any, faint_mm: float = 0.0) -> None:
        self._radius_mm = np.hypot(_RADIUS_MM, faint_mm)
        self._measure, self._elastic, self._shared, self._functions = measure, elastic, shared, BorderFunctions()
        self._shares = dict[tuple[bool, int], float]()

    def estimate(
        self, number: Numbers, position: Array, displacement: Array, variance: Array, counts: Mask,
        border: FrameEllipse, since: Callable[[Numbers], Array],
    ) -> FrameEnergies:  # fmt: skip
        """Return the strain energies of the skin in contact in n frames, with standard deviations; NaN where no point
        lies near the contact border, and where no smooth field explains the displacements.

        Errors of neighbours correlate over less than the field can resolve. They act as independent errors whose
        variance is that of a point times the sum of its correlations with all points.

        Args:
            number: (n,) of the frames.
            position: (n, N, 2) mm.
            displacement: (n, N, 2) mm.
            variance: (n, N) mm^2 of a displacement component.
            counts: (n, N) points in contact whose displacement counts from their onset.
            border: of these n frames, smoothed over time.
            since: gives, for numbers (k,) of these frames, the motion (k, N, 2) mm of all points since the
                border was `GROWTH_MM` inside its present position.
        """
        counts = counts & np.isfinite(displacement).all(-1) & np.isfinite(variance)
        of_point = np.maximum(variance, _LEAST_MM**2) * (counts @ self._shared)
        energy, deviation = np.full((2, len(counts)), np.nan)
        result = FrameEnergies(energy, deviation, np.zeros(len(counts), bool), np.ones(len(counts)))
        depth = border.inside(position)
        outer, inner = ((counts & (depth >= low) & (depth < low + _OUTER_MM)).any(1) for low in (0.0, _OUTER_MM))
        frames = np.flatnonzero(outer & inner)
        if len(frames):
            here, border = np.flatnonzero(counts[frames].any(0)), border.select(frames)
            at = np.ix_(frames, here)
            cosine, sine = np.cos(border.angle), np.sin(border.angle)
            turn = np.stack((cosine, sine, -sine, cosine), axis=-1).reshape(-1, 2, 2)
            vectors = position[at] - border.center[:, None], displacement[at]
            from_centre, moved = (np.where(counts[at][..., None], part, 0.0).mT.copy() for part in vectors)
            weight = np.where(counts[at], 1 / np.where(counts[at], of_point[at], 1), 0.0)
            points = _Points(number[frames], turn @ from_centre, moved, weight, border.semi_axes, turn)
            energies = self._energies(points, since(frames)[:, here], depth[at])
            for values, of_some in zip(result, energies, strict=True):
                values[frames] = of_some
        return result

    def _energies(self, points: "_Points", since_growth: Array, depth: Array) -> FrameEnergies:
        """Return the energies of the field that explains the displacements better: one that vanishes at the border, or
        one that moves there. Where the border advances, only the first is possible. Where that cannot be told, as
        frames are few, half of their difference is part of the deviation, and the energy is their mean if the second is
        likelier.
        """
        field = self._functions.fit(*points.on_disc())
        moves, trust = np.zeros(len(points.axes), bool), np.ones(len(points.axes))
        result = FrameEnergies(*self._estimate(field, points), moves, trust)
        noise = field.noise.copy()
        prior, unresolved = _border_motion(points, since_growth, depth)
        frames = np.flatnonzero(prior > 0)
        if len(frames):
            doubtful = points.select(frames)
            moving = self._functions.fit(*doubtful.on_disc(), prior[frames])
            likelier = moving.evidence > field.evidence[frames] + _DECISIVE
            either = np.flatnonzero(likelier | unresolved[frames])
            energy, deviation = (values[either] for values in self._estimate(moving, doubtful, prior[frames]))
            frames, likelier = frames[either], likelier[either]
            noise[frames] = np.where(likelier, moving.noise[either], noise[frames])
            half = np.where(unresolved[frames], (result.energy[frames] - energy) / 2, 0)
            for values, of_moving in zip(result[:3], (energy + half, deviation, ~unresolved[frames]), strict=True):
                values[frames] = np.where(likelier, of_moving, values[frames])
            result.deviation[frames] = np.hypot(result.deviation[frames], half)
        number, total = (points.weight > 0).sum(1), points.weight.sum(1)
        # Variance of the residuals, relative to the stated one, up to which they may be those of any smooth field.
        smooth = _MISFIT**2 * (points.moved**2).sum((1, 2)) / 2 / number**2 * total
        result.trust[:] = np.clip(2 - noise / np.maximum(_UNKNOWN, smooth), 0, 1)
        result.energy[result.trust == 0] = np.nan
        return result

    def _estimate(self, field: BorderFields, points: "_Points", at_border: Array | None = None) -> tuple[Array, Array]:
        energy, forces, left = self._field_energies(field, points)
        mean = energy.sum(0) + np.trace(left, axis1=1, axis2=2)
        # Of a quadratic form of Gaussian numbers, in each of two components.
        by_points = (forces * (field.covariance @ forces)).sum((1, 2)) + (left * left.mT).sum((1, 2))
        size = (points.moved**2).sum((1, 2)) / 2 / (points.weight > 0).sum(1)
        by_tracking = 2 * mean * _COMMON_MM / np.sqrt(size + _COMMON_MM**2)
        by_border = self._shares_of_border(points, mean, at_border) * mean
        return mean, np.sqrt(by_points + by_border**2 + by_tracking**2)

    def _shares_of_border(self, points: "_Points", energy: Array, at_border: Array | None) -> Array:
        """Return the relative change (n,) of the strain energy in each of n frames if the contact border lay one
        standard deviation of its position further out, and the share of the energy where the field is extrapolated.

        They are computed in the first of `_BORDER_FRAMES` frames by number, whatever the batch, and hold for the rest.
        """
        groups, some, row = np.unique(points.number // _BORDER_FRAMES, return_index=True, return_inverse=True)
        wider = points.select(some)
        wider = wider._replace(axes=wider.axes + self._radius_mm)
        field = self._functions.fit(*wider.on_disc(), None if at_border is None else at_border[some])
        larger, _, more = self._field_energies(field, wider)
        total = larger.sum(0)
        change = (total + np.trace(more, axis1=1, axis2=2)) / energy[some] - 1
        shares = np.hypot(change, np.where(wider.far(self._functions.places), larger, 0).sum(0) / total)
        pairs = zip(groups.tolist(), shares.tolist(), strict=True)
        return np.array([self._shares.setdefault((at_border is None, group), share) for group, share in pairs])[row]

    def _field_energies(self, field: BorderFields, points: "_Points") -> tuple[Array, Array, Array]:
        """Return the elastic energies (P, n) of displacement fields at the places, their gradients (n, K, 2) in the K
        fit coefficients, and the product (n, K, K) of energy matrix and coefficient covariance, whose trace is the
        energy that uncertainty adds.

        C is the covariance of the coefficients of a component, and Q (n, K, K) that of the energy, a quadratic form in
        them to first order: the trace of Q C is the mean energy of what is left uncertain.
        """
        number, area = field.coefficients.shape[1], np.pi * points.axes.prod(1)
        functions, gradient = self._functions, self._functions.gradient[..., :number]
        # By the place in the disc, (2, P, n, 2) [direction, ..., component], then by x and y.
        slope = torch.from_numpy(np.tensordot(gradient, field.coefficients, (2, 1)))
        turn = (points.turn / points.axes[:, :, None]).transpose(2, 1, 0)  # (2, 2, n) [x or y, direction]
        onto = torch.from_numpy(turn)
        (ux, uy), (vx, vy) = (slope[0, ..., k] * onto[:, None, 0] + slope[1, ..., k] * onto[:, None, 1] for k in (0, 1))
        # du/dx by the place now; by the place at onset it is F - 1 with F = (1 - du/dx)^-1, and areas were 1 / det F.
        shrunk = (1 - ux) * (1 - vy) - uy * vx
        since = (1 - vy) / shrunk - 1, uy / shrunk, vx / shrunk, (1 - ux) / shrunk - 1
        exx, eyy, exy = strain_parts(*since, self._measure)
        weights = torch.from_numpy(functions.weights[:, None] * area)
        energy = energy_form(exx * exx, eyy * eyy, exy * exy, exx * eyy, *self._elastic) * shrunk * weights
        xx, yy, xy = (weights * part for part in stress_parts(exx, eyy, exy, *self._elastic))
        stress = [torch.stack((xx * x + xy * y, xy * x + yy * y)) for x, y in onto.transpose(0, 1)]
        forces = np.tensordot(gradient, torch.stack(stress).numpy(), ((0, 1), (0, 2))).transpose(2, 0, 1)
        direct, _, shear = stiffness(*self._elastic)
        # The mean over both components, each with direct x x + shear / 4 y y, where x and y are exchanged.
        scale = ((direct + shear / 4) * area)[:, None] / points.axes**2
        return energy.numpy(), forces, np.tensordot(scale, functions.squares[:, :number, :number], 1) @ field.covariance


class _Points(NamedTuple):
    """Displacements and weights of N points in n frames, with positions along the axes of the ellipse that bounds the
    contact.
    """

    number: Numbers  # (n,) of the frames
    along: Array  # (n, 2, N) mm along the ellipse's axes, from its centre
    moved: Array  # (n, 2, N) mm displacement in x and y
    weight: Array  # (n, N) inverse variance of a displacement component, 1/mm^2; 0 where a point does not count
    axes: Array  # (n, 2) mm, semi-axes
    turn: Array  # (n, 2, 2), from x and y to the axes

    def select(self, frames: Numbers | slice) -> "_Points":
        return _Points(*(values[frames] for values in self))

    def far(self, places: Array) -> Mask:
        """Return the mask (P, n) of `places` (P, 2) in the unit disc that are far from all points of a frame."""
        frames = zip(self.along, self.weight, self.axes, strict=True)
        away = [cdist(places * axes, along[:, weight > 0].T).min(1) for along, weight, axes in frames]
        return np.stack(away, axis=1) > _FAR_MM

    def on_disc(self) -> tuple[Array, Array, Array]:
        """Return positions (n, 2, N) in the unit disc, displacements and weights, as arguments of a fit."""
        return self.along / self.axes[..., None], self.moved, self.weight


def _border_motion(points: "_Points", since_growth: Array, depth: Array) -> tuple[Array, Mask]:
    """Return how far (n,) mm skin at the border may have moved since the border passed, RMS of a component, 0 where the
    border advances, and a mask (n,) of frames in which this cannot be told, as it advanced in the last frame.

    `since_growth` (n, N, 2) mm is the motion since the border was `GROWTH_MM` further inside; `depth` (n, N) mm.
    """
    outer = (points.weight > 0) & (depth < _OUTER_MM) & np.isfinite(since_growth).all(-1)
    number = outer.sum(1).clip(1)
    both = since_growth, points.moved.mT
    square, since_onset = (np.where(outer, (moved**2).mean(2), 0).sum(1) / number for moved in both)
    unresolved = outer.any(1) & (square == 0)
    lags = square > _LAG**2 * since_onset
    return np.sqrt(np.where(unresolved, since_onset, np.where(lags, square, 0))), unresolved


def perimeter(semi_axes: Array) -> Array:
    """Return the perimeters (n,) mm of ellipses with semi-axes (n, 2) mm, the major one in the first column."""
    major, minor = semi_axes.T
    return 4 * major * np.asarray(ellipe(1 - (minor / major) ** 2))
