"""Correlate windows of two images, and fit the deformation by which they match best, in NumPy.

An engine samples the windows.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fingerflow.engines.together import Steps

Array = NDArray[Any]
#: Returns the grey levels (N, m) of windows in frames (N,) around places (N, 2) px, deformed by warps (N, 2, 2).
Sampler = Callable[[Array, Array, Array], Steps[Array]]

_LEAST_VARIANCE = 1e-12
_ROUNDS = 4
_BESIDE = 0.5  # px, half the step of the central differences
_FARTHEST = 0.15  # largest change of a component of the deformation in one iteration


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
    """Fit the deformations (N, 2, 2), starting from `warp`, for which windows correlate best with earlier windows.

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
