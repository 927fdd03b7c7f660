"""Correlate windows of two images, and fit the deformation or the shift by which they match best, in NumPy.

An engine samples the windows.
"""

from collections.abc import Callable

import numpy as np

from fingerflow.kernels.array_types import Array
from fingerflow.kernels.library import compiled, is_present
from fingerflow.kernels.tracking_limits import LEAST_VARIANCE, MAD, TUKEY, WEIGHT_ROUNDS

#: Function that returns the grey levels (N, m) of windows in frames (N,) around places (N, 2) px, deformed by warps
#: (N, 2, 2).
Sampler = Callable[[Array, Array, Array], Array]

_ROUNDS = 4
_BESIDE = 0.5  # px, half the step of the central differences
_FARTHEST = 0.15  # largest change of a component of the deformation in one iteration
_SHIFT_ROUNDS = 2  # samplings of the windows, each followed by fits


# Shifts (N, 2) px by which most samples of N windows match those of earlier windows best, 0 for a window with a sample
# that is NaN or infinite; weights (N, m) of the samples in the fit, 0 for samples that do not match; lengths (N,) of
# the shifts in their own standard deviations, which are large along straight ridges; largest residuals (N,) in standard
# deviations of all.
Shifts = tuple[Array, Array, Array, Array]


def compare(then: Array, now: Array) -> tuple[Array, Array, Array]:
    """Compare N pairs of windows (N, m) of m grey levels, float32; the mean of each window in `then` is 0.

    Return their normalised cross-correlation (N,), NaN for blank windows, and the root mean square (N,) and largest
    magnitude (N,) of the residual, which a linear function of the first window leaves of the second one, in grey
    levels, NaN where the first window is blank.
    """
    after = now - now.mean(1, keepdims=True)
    square, covariance = _mean_product(then, then), _mean_product(then, after)
    variances = square * _mean_product(after, after)
    with np.errstate(invalid="ignore", divide="ignore"):
        residual = after - (covariance / square)[:, None] * then
    correlation = covariance / np.sqrt(np.maximum(variances, LEAST_VARIANCE))
    correlation = np.where(variances > LEAST_VARIANCE, correlation, np.float32(np.nan))
    return correlation, np.sqrt(_mean_product(residual, residual)), np.abs(residual).max(1)


def _mean_product(first: Array, second: Array) -> Array:
    """Return the means (N,) of the products of two arrays (N, m) along their rows."""
    return np.einsum("nm,nm->n", first, second) / first.shape[1]


def deformed_alike(
    first: Array, sample: Sampler, number: Array, positions: Array, warp: Array, window: int, step: int
) -> Array:
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
    steps = np.stack([coordinate.ravel() for coordinate in np.meshgrid(offsets, offsets)], axis=-1)
    constant = np.ones_like(first)[..., None]
    for _ in range(_ROUNDS):
        here = sample(number, positions, warp)
        slopes = [
            (sample(number, positions + along, warp) - sample(number, positions - along, warp)) / (2 * _BESIDE)
            for along in _BESIDE * np.eye(2, dtype=np.float32)
        ]
        by_warp = np.concatenate([slope[..., None] * steps for slope in slopes], -1)
        unknown = np.concatenate((by_warp, -first[..., None], -constant), -1)
        valid = (np.isfinite(unknown).all((1, 2)) & np.isfinite(here).all(1)).nonzero()[0]
        if not len(valid):
            break
        warp = warp.copy()
        for k in valid:
            solved = np.linalg.lstsq(unknown[k], -here[k], rcond=None)[0][:4].reshape(2, 2)
            warp[k] += np.clip(solved, -_FARTHEST, _FARTHEST)
    return warp


def shifted_alike(first: Array, sample: Sampler, number: Array, positions: Array, warp: Array, noise: float) -> Shifts:
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
    steps = np.array([[_BESIDE, 0.0], [-_BESIDE, 0.0], [0.0, _BESIDE], [0.0, -_BESIDE]], np.float32)
    around = sample(np.tile(number, 4), (positions + steps[:, None]).reshape(-1, 2), np.tile(warp, (4, 1, 1)))
    around = around.reshape(4, count, -1)
    fit: Shifts = np.zeros((count, 2)), np.ones(first.shape), *np.zeros((2, count))
    for _ in range(_SHIFT_ROUNDS):
        fit = fit_shifts(first, around, sample(number, positions + fit[0].astype(np.float32), warp), *fit[:2], noise)
    return fit


def fit_shifts(then: Array, around: Array, now: Array, shift: Array, weight: Array, noise: float) -> Shifts:
    """Improve the shifts (N, 2) px of windows and the weights (N, m) of their samples by a few reweighted least-squares
    fits.

    Args:
        then: (N, m) grey levels T of the earlier windows, float32.
        around: (4, N, m) grey levels of windows half a pixel to the right, left, below and above of no shift.
        now: (N, m) grey levels of windows at the shifts so far.
        shift, weight: float64, results of the round before.
        noise: least standard deviation of the residuals that a fit assumes, grey levels.
    """
    if is_present():
        windows = {"then": then, "around": around, "now": now, "shift": shift, "weight": weight}
        return compiled("shift_windows")(**windows, noise=noise)
    right, left, below, above = around
    unknown = np.stack((right - left, below - above, -then, -np.ones_like(then)), axis=-1).astype(np.float64)
    valid: Array = np.asarray(np.isfinite(unknown).all((1, 2)) & np.isfinite(now).all(1))
    unknown[~valid] = 0
    negative = np.where(valid[:, None], -now, 0.0)
    for _ in range(WEIGHT_ROUNDS):
        solved, residual, inverse = _weighted_fit(unknown, negative, weight)
        spread = np.maximum(MAD * np.median(np.abs(residual), axis=1), noise)
        weight = np.square(np.clip(1 - np.square(residual / (TUKEY * spread[:, None])), 0, None))
    shift = np.where(valid[:, None], shift + np.clip(solved[:, :2], -1, 1), 0.0)
    square = (shift[:, None] @ np.linalg.solve(inverse[:, :2, :2], shift[..., None]))[:, 0, 0]
    largest = np.where(valid, np.abs(residual).max(1) / spread, 0.0)
    return shift, weight, np.sqrt(square) / spread, largest


def _weighted_fit(unknown: Array, values: Array, weight: Array) -> tuple[Array, Array, Array]:
    """Solve N linear systems of m equations in 4 unknowns by weighted least squares; return the solutions (N, 4), the
    residuals (N, m) and the inverse normal matrices (N, 4, 4).

    `unknown` is (N, m, 4), `values` and `weight` are (N, m).
    """
    weighted = (unknown * weight[..., None]).mT
    matrix = weighted @ unknown
    scale = np.trace(matrix, axis1=1, axis2=2)[:, None, None]
    inverse = np.linalg.inv(matrix + (1e-12 * scale + LEAST_VARIANCE) * np.eye(4))
    solved = inverse @ (weighted @ values[..., None])
    return solved[..., 0], values - (unknown @ solved)[..., 0], inverse
