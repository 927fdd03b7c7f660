"""Zero-phase low-pass filter for samples at arbitrary times, evaluated only at the requested times.

The kernel is a sinc under a Kaiser window (Oppenheim & Schafer, Discrete-Time Signal Processing, section 7.5),
evaluated as a function of continuous time, so that neither the ratio of the rates nor the samples have to be even. The
weight of sample j is h(t_j - t) times the interval that it represents. Two further steps make exact what a sum over
samples only approximates:

- the weights are divided by their sum: a constant is preserved, also at the ends, where half the kernel is missing;
- where the kernel lies wholly inside the record, a small odd multiple of the window is added so that the first moment
  vanishes: a ramp keeps its value at any position between two samples.

Averaging over the exposure, the obvious alternative, passes 400 Hz with a gain of 21 % into frames of 300 Hz.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.polynomial import Chebyshev, Polynomial
from numpy.typing import NDArray
from scipy.special import i0

STOP_BAND_DB = 66.0
PASS_BAND, STOP_BAND = 0.5, 1.0
"""Edges in units of the Nyquist frequency: below the first the gain is 1, beyond the second 0, each within 0.1 %."""

_FRAMES_AT_ONCE = 16  # their weights fit into a processor's cache
_WINDOW_DEGREE = 12  # of the window as a polynomial; its error is at the level of rounding
_NEAR = 0.1  # rad; below it a sine from a difference of products has too few digits to be divided by its angle
_ALIKE = 1e-9  # of a step between samples; times that differ by less are equal

Samples = NDArray[np.float64]
Indices = NDArray[np.intp]


def low_pass_at(times: Samples, values: Samples, wanted: Samples, nyquist: float) -> Samples:
    """Return values (k, n) at `times` (n,) low-passed to `nyquist` (Hz) and evaluated at `wanted` (m,): (k, m).

    `times` increase strictly; `wanted` lie between the first and the last of them.
    """
    half_width = kernel_half_width(nyquist)
    first = np.searchsorted(times, wanted - half_width, side="left")
    last = np.searchsorted(times, wanted + half_width, side="right")
    interior = (wanted - half_width >= times[0]) & (wanted + half_width <= times[-1])
    width = int(np.max(last - first, initial=1))
    begin = np.minimum(first, len(times) - width)  # rows of equal length; unused samples have weight 0
    groups = _alike(times, wanted, first, last, interior)
    rate = np.pi * (PASS_BAND + STOP_BAND) * nyquist  # rad/s, cutoff in the middle of the transition band
    weigh = _Weights(times, width, half_width, rate)
    rows = sliding_window_view(values, width, axis=1)
    result = np.empty((len(values), len(wanted)))
    for start in range(0, len(groups), _FRAMES_AT_ONCE):
        some = groups[start : start + _FRAMES_AT_ONCE]
        one = np.array([frames[0] for frames in some])
        weights = weigh.at(wanted[one], begin[one], first[one] - begin[one], last[one] - begin[one], interior[one])
        for frames, own in zip(some, weights, strict=True):
            for part in range(0, len(frames), _FRAMES_AT_ONCE):
                few = frames[part : part + _FRAMES_AT_ONCE]
                result[:, few] = rows[:, begin[few]] @ own
    return result


def _alike(
    times: Samples, wanted: Samples, first: Indices, last: Indices, interior: NDArray[np.bool_]
) -> list[Indices]:
    """Return groups of frames with the same relative times of samples, so that one kernel serves each (polyphase).

    At 10 kHz and 300 frames/s there are three such groups, and some single frames near the ends.
    """
    alone = [np.array([frame]) for frame in np.flatnonzero(~interior)]
    frames = np.flatnonzero(interior)
    if not len(frames):
        return alone
    step = (times[-1] - times[0]) / max(len(times) - 1, 1)
    even = np.abs(times - (times[0] + step * np.arange(len(times)))).max() <= _ALIKE * step
    if not even:
        order = frames[np.argsort(wanted[frames])]  # neighbouring frames need the same samples
        return alone + np.split(order, np.arange(1, len(order)))
    phase = wanted[frames] - times[first[frames]]
    count = last[frames] - first[frames]
    order = np.lexsort((phase, count))
    new = (np.diff(phase[order]) > _ALIKE * step) | (np.diff(count[order]) > 0)
    return alone + np.split(frames[order], np.flatnonzero(new) + 1)


class _Weights:
    """Weights of the samples around frames, computed for groups of frames on demand."""

    def __init__(self, times: Samples, width: int, half_width: float, rate: float) -> None:
        self.half_width = half_width
        self.rate = rate
        self.middle = (times[0] + times[-1]) / 2  # keeps angles and their rounding errors small
        angle = rate * (times - self.middle)
        of_samples = np.stack((times, np.sin(angle), np.cos(angle), _stretches(times)))
        self.rows = sliding_window_view(of_samples, width, axis=1)

    def at(
        self, wanted: Samples, begin: Indices, first: Indices, last: Indices, interior: NDArray[np.bool_]
    ) -> Samples:
        """Return weights (m, w) at times (m,) of w samples from `begin` on; those outside [first, last) are 0."""
        times, sine, cosine, stretches = self.rows
        offset = times[begin]
        offset -= wanted[:, None]
        window = _kaiser(offset / self.half_width)
        _leave_out(window, first, last)
        # sin(a - b) from one sine and cosine for each sample and frame instead of one for each pair.
        angle = self.rate * (wanted - self.middle)[:, None]
        weights = sine[begin]
        weights *= np.cos(angle)
        other = cosine[begin]
        other *= np.sin(angle)
        weights -= other
        _divide_by_angle(weights, np.multiply(offset, self.rate, out=other))
        weights *= window
        weights *= stretches[begin]
        return _exact_moments(weights, window, offset, interior)


def _stretches(times: Samples) -> Samples:
    """Return the interval in s that each sample represents: half way to both neighbours.

    A gap ends the record as its ends do, so no sample represents more than twice the median step.
    """
    steps = np.diff(times)
    steps = np.minimum(steps, 2 * np.median(steps))
    stretches: Samples = (np.append(steps, 0.0) + np.append(0.0, steps)) / 2
    return stretches


def kernel_half_width(nyquist: float) -> float:
    """Return half the length of the kernel in s, from Kaiser's rule for the width of the transition."""
    transition = (STOP_BAND - PASS_BAND) * nyquist
    return (STOP_BAND_DB - 7.95) / (14.36 * transition) / 2


def _window_polynomial() -> Polynomial:
    """Return Kaiser's window as a polynomial in 1 - position^2.

    The window is an entire function of that variable; evaluating I0 itself costs ten times as much.
    """
    beta = 0.1102 * (STOP_BAND_DB - 8.7)
    interpolant = Chebyshev.interpolate(lambda square: i0(beta * np.sqrt(square)) / i0(beta), _WINDOW_DEGREE, (0, 1))
    return interpolant.convert(kind=Polynomial)


_WINDOW = tuple(map(float, _window_polynomial().coef[::-1]))


def _kaiser(position: Samples) -> Samples:
    """Return the window at `position`, which is overwritten."""
    position *= position
    square = np.subtract(1, position, out=position)
    kaiser = _WINDOW[0] * square
    for coefficient in _WINDOW[1:-1]:
        kaiser += coefficient
        kaiser *= square
    kaiser += _WINDOW[-1]
    return kaiser


def _leave_out(window: Samples, first: Indices, last: Indices) -> None:
    """Set a window (m, w) to 0 outside the samples [first, last) of each row."""
    used = int(first.max()), int(last.min())  # used by all rows; others are one or two on each side if times are even
    place = np.arange(window.shape[1])
    window[:, : used[0]] *= place[: used[0]] >= first[:, None]
    window[:, used[1] :] *= place[used[1] :] < last[:, None]


def _divide_by_angle(sine: Samples, angle: Samples) -> None:
    """Divide sin(x) by x in place, accurately for small x and 0 too; `angle` is overwritten."""
    close = np.nonzero(np.abs(angle) < _NEAR)
    near = angle[close]
    angle[close] = 1.0
    sine /= angle
    sine[close] = np.sinc(near / np.pi)


def _exact_moments(weights: Samples, window: Samples, offset: Samples, interior: NDArray[np.bool_]) -> Samples:
    """Return weights of sum 1 and, in the interior, first moment 0; the arguments are overwritten."""
    weights /= weights.sum(1, keepdims=True)
    # Odd about its own centre of mass, so that adding it changes the first moment and not the sum.
    centre = np.einsum("fj,fj->f", window, offset) / window.sum(1)
    moment = np.einsum("fj,fj->f", weights, offset)
    odd = np.multiply(window, offset - centre[:, None], out=window)
    spread = np.einsum("fj,fj->f", odd, offset)
    correctable = interior & (spread > 0)
    odd *= np.where(correctable, moment / np.where(spread > 0, spread, 1.0), 0.0)[:, None]
    weights -= odd
    return weights
