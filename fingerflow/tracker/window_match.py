"""Correlate windows of two images, and fit the deformation or the shift by which they match best, in NumPy.

An engine samples the windows.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fingerflow.engines.together import Steps

Array = NDArray[Any]
#: Function that returns the grey levels (N, m) of windows in frames (N,) around places (N, 2) px, deformed by warps
#: (N, 2, 2).
Sampler = Callable[[Array, Array, Array], Steps[Array]]

_LEAST_VARIANCE = 1e-12
_ROUNDS = 4
_BESIDE = 0.5  # px, half the step of the central differences
_FARTHEST = 0.15  # largest change of a component of the deformation in one iteration
_SHIFT_ROUNDS, _WEIGHT_ROUNDS = 2, 4  # samplings of the windows, and reweightings after each
_TUKEY, _MAD = 4.685, 1.4826  # deviations beyond which a sample has no weight; deviation over the median of |residual|
_EXCLUDED = 0.05  # weight of a sample below which it counts as excluded


class Centred(NamedTuple):
    """Windows (N, m) of m grey levels minus their mean, and the variance (N,) of each window."""

    part: Array
    variance: Array

    @classmethod
    def of(cls, windows: Array) -> Centred:
        """Return windows (N, m) of grey levels minus their mean, with the variance of each window."""
        part = windows - windows.mean(1, keepdims=True)
        return cls(part, np.square(part).mean(1))


def correlation_of(first: Centred, second: Centred) -> Array:
    """Return the normalised cross-correlation (N,) of pairs of centred windows; NaN for blank windows.

    It is independent of gain and offset.
    """
    variances = first.variance * second.variance
    found = (first.part * second.part).mean(1) / np.sqrt(np.maximum(variances, _LEAST_VARIANCE))
    result: Array = np.where(variances > _LEAST_VARIANCE, found, np.float32(np.nan))
    return result


def deformed_alike(
    first: Array, sample: Sampler, number: Array, places: Array, warp: Array, window: int, step: int
) -> Steps[Array]:
    """Fit the deformation gradients (N, 2, 2), starting from `warp`, with which windows in present images correlate
    best with the earlier windows `first` (N, m).

    Centres stay fixed. Gauss-Newton for a T + b = I(place + F w) in gain a, offset b and the four components of F. As
    the centre is fixed, a window with a wrong centre keeps a residual.

    Args:
        first: (N, m) grey levels T of the earlier windows.
        sample: samples windows in the present images I.
        number, places, warp: image (N,), centre (N, 2) px and initial deformation (N, 2, 2) of the windows.
        window, step: px, side of a window and step of its grid.
    """
    offsets = np.arange(-(window // 2), window // 2 + 1, step, dtype=np.float32)
    steps = np.stack([one.ravel() for one in np.meshgrid(offsets, offsets)], axis=-1)
    ones = np.ones_like(first)[..., None]
    for _ in range(_ROUNDS):
        here = yield from sample(number, places, warp)
        slopes = []
        for along in np.array([[_BESIDE, 0.0], [0.0, _BESIDE]], np.float32):
            ahead = yield from sample(number, places + along, warp)
            behind = yield from sample(number, places - along, warp)
            slopes.append((ahead - behind) / (2 * _BESIDE))
        by_warp = np.concatenate([slope[..., None] * steps for slope in slopes], -1)
        unknown = np.concatenate((by_warp, -first[..., None], -ones), -1)
        known = np.flatnonzero(np.isfinite(unknown).all((1, 2)) & np.isfinite(here).all(1))
        if not len(known):
            break
        warp = warp.copy()
        for k in known:
            solved = np.linalg.lstsq(unknown[k], -here[k], rcond=None)[0][:4].reshape(2, 2)
            warp[k] += np.clip(solved, -_FARTHEST, _FARTHEST)
    return warp


class Shifted(NamedTuple):
    """Shifts by which most samples of N windows match those of earlier windows best, with their significance and the
    share of samples that do not match.

    Attributes:
        shift: (N, 2) px; 0 where it cannot be found.
        deviations: (N,) length of the shift in its own standard deviations, which are large along straight ridges.
        excluded: (N,) share of the samples that do not match by then, and have no weight.
    """

    shift: Array
    deviations: Array
    excluded: Array


def shifted_alike(
    first: Array, sample: Sampler, number: Array, places: Array, warp: Array, noise: float
) -> Steps[Shifted]:
    """Fit the shifts by which most samples of windows in present images match the earlier windows `first` (N, m), with
    robust weights that exclude the samples that do not match.

    Gauss-Newton for a T + b = I(place + shift + F w) in the shift, gain a and offset b, with Tukey's biweight of the
    residual: what covers a small part of a window and does not move with it, as dust on the glass, has no weight.

    Args:
        first: (N, m) grey levels T of the earlier windows.
        sample: samples windows in the present images I.
        number, places, warp: image (N,), centre (N, 2) px and deformation F (N, 2, 2) of the windows.
        noise: least standard deviation of the residuals that a fit assumes, grey levels.
    """
    count = len(first)
    beside = np.array([[_BESIDE, 0.0], [-_BESIDE, 0.0], [0.0, _BESIDE], [0.0, -_BESIDE]], np.float32)
    around = yield from sample(np.tile(number, 4), (places + beside[:, None]).reshape(-1, 2), np.tile(warp, (4, 1, 1)))
    right, left, below, above = around.reshape(4, count, -1)
    slopes = ((right - left) / (2 * _BESIDE), (below - above) / (2 * _BESIDE))
    unknown = np.stack((*slopes, -first, -np.ones_like(first)), axis=-1).astype(np.float64)
    shift, weight = np.zeros((count, 2)), np.ones(first.shape)
    known: Array = np.asarray(np.isfinite(unknown).all((1, 2)))
    unknown[~known] = 0
    for _ in range(_SHIFT_ROUNDS):
        here = yield from sample(number, places + shift.astype(np.float32), warp)
        known &= np.isfinite(here).all(1)
        given = np.where(known[:, None], -here, 0.0)
        for _ in range(_WEIGHT_ROUNDS):
            solved, residual, inverse = _weighted_fit(unknown, given, weight)
            spread = np.maximum(_MAD * np.median(np.abs(residual), axis=1), noise)
            weight = np.square(np.clip(1 - np.square(residual / (_TUKEY * spread[:, None])), 0, None))
        shift += np.clip(solved[:, :2], -1, 1)
    shift[~known] = 0
    square = (shift[:, None] @ np.linalg.solve(inverse[:, :2, :2], shift[..., None]))[:, 0, 0]
    return Shifted(shift, np.sqrt(square) / spread, np.where(known, (weight < _EXCLUDED).mean(1), 0.0))


def _weighted_fit(unknown: Array, given: Array, weight: Array) -> tuple[Array, Array, Array]:
    """Solve N linear systems of m equations in 4 unknowns by weighted least squares; return the solutions (N, 4), the
    residuals (N, m) and the inverse normal matrices (N, 4, 4).

    `unknown` is (N, m, 4), `given` and `weight` are (N, m).
    """
    weighted = (unknown * weight[..., None]).mT
    matrix = weighted @ unknown
    scale = np.trace(matrix, axis1=1, axis2=2)[:, None, None]
    inverse = np.linalg.inv(matrix + (1e-12 * scale + _LEAST_VARIANCE) * np.eye(4))
    solved = inverse @ (weighted @ given[..., None])
    return solved[..., 0], given - (unknown @ solved)[..., 0], inverse
