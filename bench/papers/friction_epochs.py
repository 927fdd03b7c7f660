"""Friction coefficient against vibration amplitude, from a tribometer trace (Willemet et al. 2021, figure S1 A and B).

The plate's ultrasonic vibration is modulated with a 4 Hz sinusoid while a finger slides back and forth. An epoch is a
half period in which the envelope rises and the finger moves from right to left throughout. The coefficient is |T| / N.

A sinusoid dwells at its ends: in the bin from 0 to 1/6 of its range half the samples lie below 0.044 of it, not 0.083.
Each sample of a bin therefore counts by |da/dt| of the sinusoid a(t), so that every amplitude counts alike.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.signal import savgol_filter
from torch import Tensor

# Number of windows in a half period; the finger's velocity is the slope of a line fitted over about one window.
_PARTS = 25


@dataclass(frozen=True)
class FrictionEpochs:
    """Friction coefficients in E sliding epochs and A bins of vibration amplitude; NaN in a bin without samples."""

    start: Tensor  # (E,) int64, index of the first sample
    stop: Tensor  # (E,) int64, index after the last sample
    edges: Tensor  # (A + 1,) m, bounds of the amplitude bins
    median: Tensor  # (E, A) median of |T| / N, weighted so that all amplitudes of a bin count equally
    spread: Tensor  # (E, A) interquartile range of |T| / N, with the same weights
    count: Tensor  # (E, A) int64, number of samples

    def over_epochs(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return median and interquartile range of friction over the epochs, and the number of epochs, by bin (A,).

        An epoch counts with its median in a bin of vibration amplitude.
        """
        columns = [column[np.isfinite(column)] for column in self.median.T.numpy()]
        rows = [_median_and_iqr(column, np.ones(len(column))) for column in columns]
        of = torch.tensor(rows, dtype=torch.float64).reshape(-1, 2)
        return of[:, 0], of[:, 1], self.median.isfinite().sum(0)


def friction_epochs(
    time: Tensor,
    normal: Tensor,
    tangential: Tensor,
    position: Tensor,
    amplitude: Tensor,
    edges: Tensor,
    *,
    modulation_hz: float = 4.0,
    least_speed: float = 5e-3,
) -> FrictionEpochs:
    """Compute the friction coefficient |T| / N (tangential over normal force) of a tribometer trace, for each epoch of
    sliding and in bins of vibration amplitude between `edges`.

    The rise of the envelope is taken from the best-fitting sinusoid at ``modulation_hz``. The finger's motion is taken
    from slopes of its position over about 1 / 25 of a half period. Neither depends on the noise of single samples.

    Args (all float64):
        time: (T,) s, evenly spaced.
        normal, tangential: (T,) N; a sample counts where both are known and the normal force is positive.
        position: (T,) m of the finger along the plate, growing to the right.
        amplitude: (T,) m, the envelope of the vibration.
        edges: (A + 1,) m, rising: the bins of amplitude.
        least_speed: m/s to the left, below which the finger does not count as sliding.
    """
    at, load, drag, along, height = (signal.numpy() for signal in (time, normal, tangential, position, amplitude))
    ratio = np.where(load > 0, np.abs(drag) / np.where(load > 0, load, 1.0), np.nan)
    step = float(at[-1] - at[0]) / (len(at) - 1)
    half = 0.5 / modulation_hz
    width = max(1, min(round(half / step / _PARTS / 2), (len(at) - 1) // 2))
    sliding = savgol_filter(along, 2 * width + 1, polyorder=1, deriv=1, delta=step) < -least_speed
    first, last = [], []
    rises, speed = _fit_modulation(at, height, modulation_hz)
    for begin in rises:
        start, stop = np.searchsorted(at, (begin - 1e-6 * half, begin + half * (1 + 1e-6)))
        if begin >= at[0] - step / 2 and begin + half <= at[-1] + step / 2 and sliding[start:stop].all():
            first.append(start)
            last.append(stop)
    bins = np.searchsorted(edges.numpy(), height, side="right") - 1
    chosen = [
        [
            start + np.flatnonzero((bins[start:stop] == k) & np.isfinite(ratio[start:stop]))
            for k in range(len(edges) - 1)
        ]
        for start, stop in zip(first, last, strict=True)
    ]
    shape = (len(first), len(edges) - 1)
    quartiles = [[_median_and_iqr(ratio[samples], speed[samples]) for samples in row] for row in chosen]
    of = torch.tensor(quartiles, dtype=torch.float64).reshape(*shape, 2)
    count = torch.tensor([[len(samples) for samples in row] for row in chosen], dtype=torch.int64).reshape(shape)
    begins, ends = (torch.tensor(list(map(int, indices)), dtype=torch.int64) for indices in (first, last))
    return FrictionEpochs(begins, ends, edges, of[..., 0], of[..., 1], count)


def _fit_modulation(
    time: NDArray[np.float64], amplitude: NDArray[np.float64], frequency: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit a sinusoid a(t) of a given frequency (Hz) to a vibration amplitude (T,); return the times (s) of its minima,
    and |da/dt| (T,) relative to its maximum.
    """
    phase = 2 * np.pi * frequency * (time - time[0])
    columns = np.stack((np.ones_like(phase), np.cos(phase), np.sin(phase)), 1)
    cosine, sine = np.linalg.lstsq(columns, amplitude, rcond=None)[0][1:].tolist()
    lowest = (math.atan2(sine, cosine) + math.pi) % (2 * math.pi)  # phase of the minimum of cos(phase - angle)
    periods = np.arange(-1, phase[-1] / (2 * np.pi) + 1)
    return time[0] + (lowest / (2 * np.pi) + periods) / frequency, np.abs(np.sin(phase - lowest))


def _median_and_iqr(values: NDArray[np.float64], weights: NDArray[np.float64]) -> tuple[float, float]:
    """Return the weighted median and interquartile range of values; NaN if all weights are 0.

    A value stands at the middle of its weight in the distribution; between values the quantile is linear.
    """
    order = np.argsort(values)
    until = weights[order].cumsum()
    if not (until.size and until[-1] > 0):
        return math.nan, math.nan
    share = (until - weights[order] / 2) / until[-1]
    low, middle, high = np.interp((0.25, 0.5, 0.75), share, values[order])
    return float(middle), float(high - low)
