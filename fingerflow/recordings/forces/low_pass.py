"""Zero-phase low-pass filter for irregular samples, evaluated only at requested times.

The kernel is a sinc under a Kaiser window (Oppenheim & Schafer, Discrete-Time Signal Processing, section 7.5),
evaluated as a function of continuous time, so that neither the ratio of the rates nor the samples have to be even. The
weight of sample j is h(t_j - t) times the interval that it represents. Two further steps make exact what a sum over
samples only approximates:

- the weights are divided by their sum: a constant is preserved, also at the ends, where half the kernel is missing;
- where the kernel lies wholly inside the record, a small odd multiple of the window is added so that the first moment
  vanishes: a ramp keeps its value at any position between two samples.

Averaging over the exposure, the obvious alternative, passes 400 Hz with a gain of 21 % into frames of 300 Hz.
"""

from functools import cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.polynomial import Chebyshev, Polynomial
from numpy.polynomial.polynomial import polyval
from numpy.typing import NDArray

STOP_BAND_DB = 66.0
PASS_BAND, STOP_BAND = 0.5, 1.0
"""Edges in units of the Nyquist frequency: below the first the gain is 1, beyond the second 0, each within 0.1 %."""

_FRAMES_AT_ONCE = 16  # number of frames whose weights fit into a processor's cache
_WINDOW_DEGREE = 12  # degree of the polynomial that replaces the window; its error is at the level of rounding
# rad, angle below which a sine computed as a difference of products has too few digits to be divided by the angle.
_NEAR = 0.1
_ALIKE = 1e-9  # share of a step between samples below which two times are equal

Samples = NDArray[np.float64]
Indices = NDArray[np.intp]


def low_pass(times: Samples, values: Samples, targets: Samples, nyquist: float) -> Samples:
    """Low-pass filter k channels (k, n), sampled at `times` (n,) in s, with a stop band from `nyquist` (Hz) on, and
    return their values (k, m) at the times `targets` (m,).

    `times` increase strictly; `targets` lie between the first and the last of them.
    """
    half_width = kernel_half_width(nyquist)
    first = np.searchsorted(times, targets - half_width, side="left")
    last = np.searchsorted(times, targets + half_width, side="right")
    interior = (targets - half_width >= times[0]) & (targets + half_width <= times[-1])
    width = int(np.max(last - first, initial=1))
    begin = np.minimum(first, len(times) - width)  # first sample of rows of equal length; unused samples have weight 0
    groups = _group_frames(times, targets, first, last, interior)
    rate = np.pi * (PASS_BAND + STOP_BAND) * nyquist  # rad/s, cutoff frequency in the middle of the transition band
    middle = (times[0] + times[-1]) / 2  # the origin in the middle keeps angles and their rounding errors small
    angles = rate * (times - middle)
    # A sample represents the time between the midpoints to its neighbours. A gap ends the record as its ends do, so no
    # sample represents more than twice the median step.
    steps = np.diff(times)
    steps = np.minimum(steps, 2 * np.median(steps))
    durations = (np.append(steps, 0.0) + np.append(0.0, steps)) / 2
    around_frames = sliding_window_view(np.stack((times, np.sin(angles), np.cos(angles), durations)), width, axis=1)
    rows = sliding_window_view(values, width, axis=1)
    result = np.empty((len(values), len(targets)))
    for start in range(0, len(groups), _FRAMES_AT_ONCE):
        batch = groups[start : start + _FRAMES_AT_ONCE]
        heads = np.array([frames[0] for frames in batch])
        samples = begin[heads, None] + np.arange(width)
        neighbours, sine, cosine, stretches = around_frames[:, begin[heads]]
        offset = neighbours - targets[heads, None]
        window = polyval(1 - (offset / half_width) ** 2, _window_polynomial())
        window *= (samples >= first[heads, None]) & (samples < last[heads, None])
        # Compute sin(a - b) from the sines and cosines of samples and frames, not from those of each pair.
        angle = rate * (targets[heads, None] - middle)
        sine, angle = sine * np.cos(angle) - cosine * np.sin(angle), offset * rate
        near = np.abs(angle) < _NEAR
        sinc = sine / np.where(near, 1.0, angle)
        sinc[near] = np.sinc(angle[near] / np.pi)
        weights = _exact_moments(sinc * window * stretches, window, offset, interior[heads])
        for frames, weight in zip(batch, weights, strict=True):
            for part in range(0, len(frames), _FRAMES_AT_ONCE):
                few = frames[part : part + _FRAMES_AT_ONCE]
                result[:, few] = rows[:, begin[few]] @ weight
    return result


def _group_frames(
    times: Samples, targets: Samples, first: Indices, last: Indices, interior: NDArray[np.bool_]
) -> list[Indices]:
    """Return groups of indices into the frame times `targets`; the frames of a group have samples at equal times
    relative to the frame, so that one set of filter weights serves them all (polyphase filter).

    Samples `first` to `last` - 1 lie under the kernel of a frame; `interior` marks frames whose kernel lies wholly
    inside the record.

    At 10 kHz and 300 frames/s there are three such groups, and some single frames near the ends.
    """
    alone = [np.array([frame]) for frame in np.flatnonzero(~interior)]
    frames = np.flatnonzero(interior)
    if not len(frames):
        return alone
    step = (times[-1] - times[0]) / max(len(times) - 1, 1)
    even = np.abs(times - (times[0] + step * np.arange(len(times)))).max() <= _ALIKE * step
    if not even:
        order = frames[np.argsort(targets[frames])]  # sorted by time, since neighbouring frames need the same samples
        return alone + np.split(order, np.arange(1, len(order)))
    phase = targets[frames] - times[first[frames]]
    count = last[frames] - first[frames]
    order = np.lexsort((phase, count))
    new = (np.diff(phase[order]) > _ALIKE * step) | (np.diff(count[order]) > 0)
    return alone + np.split(frames[order], np.flatnonzero(new) + 1)


def kernel_half_width(nyquist: float) -> float:
    """Return half the length, s, of the low-pass kernel for a Nyquist frequency (Hz), from its transition width by
    Kaiser's rule.
    """
    return (STOP_BAND_DB - 7.95) / (14.36 * ((STOP_BAND - PASS_BAND) * nyquist)) / 2


@cache
def _window_polynomial() -> Samples:
    """Return the coefficients, constant first, of a polynomial in 1 - p^2 that approximates the Kaiser window at
    position p, which runs from -1 to 1 along the window.

    The window is an entire function of that variable; evaluating I0 itself costs ten times as much.
    """
    from scipy.special import i0  # a deployment bundle loads this module without SciPy

    beta = 0.1102 * (STOP_BAND_DB - 8.7)
    interpolant = Chebyshev.interpolate(lambda square: i0(beta * np.sqrt(square)) / i0(beta), _WINDOW_DEGREE, (0, 1))
    return np.asarray(interpolant.convert(kind=Polynomial).coef)


def _exact_moments(weights: Samples, window: Samples, offset: Samples, interior: NDArray[np.bool_]) -> Samples:
    """Return filter weights (m, w), for m frames and w samples each, corrected to a sum of 1 and, for `interior`
    frames, to a first moment of 0.

    The correction uses the window values (m, w) and the sample times relative to the frame, `offset` (m, w). Frames are
    `interior` if their kernel lies wholly inside the record.
    """
    weights = weights / weights.sum(1, keepdims=True)
    # The window times the offset from its own centre of mass: adding it changes the first moment and not the sum.
    centre = np.einsum("fj,fj->f", window, offset) / window.sum(1)
    moment = np.einsum("fj,fj->f", weights, offset)
    odd = window * (offset - centre[:, None])
    spread = np.einsum("fj,fj->f", odd, offset)
    correctable = interior & (spread > 0)
    weights -= odd * np.where(correctable, moment / np.where(spread > 0, spread, 1.0), 0.0)[:, None]
    return weights
