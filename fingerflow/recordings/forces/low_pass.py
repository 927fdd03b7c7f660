"""A zero-phase low-pass filter of samples at any times, evaluated only at the times that are wanted.

The kernel is a sinc under a Kaiser window (Oppenheim & Schafer, Discrete-Time Signal Processing, section 7.5), taken
as a function of continuous time, so that neither the ratio of the rates nor the samples have to be even. Sample j
weighs h(t_j - t) times the stretch of time that it stands for. Two more steps make exact what a sum over samples
would only come near to:

- the weights are divided by their sum: a constant stays what it is, also at the ends, where half the kernel is missing;
- where the kernel lies wholly inside the record, a small odd multiple of the window is added so that the first moment
  vanishes: a ramp keeps its value at any position between two samples.

Averaging over the exposure, the obvious other choice, lets 400 Hz pass with 21 % into frames of 300 Hz.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import i0

STOP_BAND_DB = 66.0
PASS_BAND, STOP_BAND = 0.5, 1.0
"""Edges in units of the Nyquist frequency: below the first the gain is 1, beyond the second 0, each within 0.1 %."""

FRAMES_AT_ONCE = 256

Samples = NDArray[np.float64]


def low_pass_at(times: Samples, values: Samples, wanted: Samples, nyquist: float) -> Samples:
    """Values (k, n) at `times` (n,) low-passed to `nyquist` (Hz) and evaluated at `wanted` (m,): (k, m).

    `times` increase strictly; `wanted` lie between the first and the last of them.
    """
    half_width = kernel_half_width(nyquist)
    stretches = _stretches(times)
    first = np.searchsorted(times, wanted - half_width, side="left")
    last = np.searchsorted(times, wanted + half_width, side="right")
    result = np.empty((len(values), len(wanted)))
    for start in range(0, len(wanted), FRAMES_AT_ONCE):
        part = slice(start, start + FRAMES_AT_ONCE)
        reach = np.arange(int(np.max(last[part] - first[part])))
        index = first[part, None] + reach
        used = index < last[part, None]
        index = np.where(used, index, first[part, None])
        offset = times[index] - wanted[part, None]
        window = np.where(used, _kaiser(offset / half_width), 0.0)
        weights = np.sinc((PASS_BAND + STOP_BAND) * nyquist * offset) * window * stretches[index]  # cut off half way
        interior = (wanted[part] - half_width >= times[0]) & (wanted[part] + half_width <= times[-1])
        weights = _exact_moments(weights, window, offset, interior)
        result[:, part] = np.einsum("fj,kfj->kf", weights, values[:, index])
    return result


def _stretches(times: Samples) -> Samples:
    """Time that each sample stands for: half way to both neighbours. A gap ends the record as its ends do, so no sample
    stands for more than twice the median."""
    steps = np.diff(times)
    steps = np.minimum(steps, 2 * np.median(steps))
    stretches: Samples = (np.append(steps, 0.0) + np.append(0.0, steps)) / 2
    return stretches


def kernel_half_width(nyquist: float) -> float:
    """Half the length of the kernel in s, from Kaiser's rule for the width of the transition."""
    transition = (STOP_BAND - PASS_BAND) * nyquist
    return (STOP_BAND_DB - 7.95) / (14.36 * transition) / 2


def _kaiser(position: Samples) -> Samples:
    beta = 0.1102 * (STOP_BAND_DB - 8.7)
    kaiser: Samples = i0(beta * np.sqrt(np.clip(1 - position**2, 0.0, None))) / i0(beta)
    return kaiser


def _exact_moments(weights: Samples, window: Samples, offset: Samples, interior: NDArray[np.bool_]) -> Samples:
    weights = weights / weights.sum(1, keepdims=True)
    # Odd about its own centre of mass, so that adding it changes the first moment and not the sum.
    centre = (window * offset).sum(1, keepdims=True) / window.sum(1, keepdims=True)
    odd = window * (offset - centre)
    spread = (odd * offset).sum(1, keepdims=True)
    moment = (weights * offset).sum(1, keepdims=True)
    correctable = interior[:, None] & (spread > 0)
    return weights - np.where(correctable, moment / np.where(spread > 0, spread, 1.0), 0.0) * odd
