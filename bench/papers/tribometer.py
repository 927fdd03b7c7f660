"""Simulated tribometer trace of a finger that slides back and forth on a plate with modulated vibration amplitude, and
figures S1 A and B of Willemet et al. 2021 from it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from matplotlib.axes import Axes
from numpy.typing import NDArray

from bench.papers.friction_epochs import FrictionEpochs, friction_epochs
from fingerflow.plot.axes_style import GREEN, GREY, INK, YELLOW, finished, line_styles
from fingerflow.plot.captions import describe

Values = NDArray[np.float64]
MODULATION_HZ, FORCE_N = 4.0, 0.5  # printed frequency of the modulation and printed normal force
_BINS = 6  # number of amplitude bins: the paper has six levels besides zero amplitude
_RATE_HZ, _STROKES, _STROKE_S = 1000, 6, 2.0
_SPEED, _REACH = 0.05, 0.1  # m/s and m, speed and length of a stroke
_NOISE_N = 1e-3  # N, standard deviation of a sample


@dataclass(frozen=True)
class TribometerTrace:
    """Recording, in T samples, of a finger sliding to and fro on a plate whose vibration amplitude is modulated, and
    the friction coefficients in six bins of amplitude, for each epoch: a stretch of sliding in which it rises.
    """

    time: Values  # (T,) s
    normal: Values  # (T,) N, positive in compression
    tangential: Values  # (T,) N
    position: Values  # (T,) m, growing to the right
    amplitude: Values  # (T,) m, envelope of the vibration
    epochs: FrictionEpochs


def simulate_trace(friction: Callable[[Values], Values], largest_um: float) -> TribometerTrace:
    """Simulate a tribometer trace: six strokes of 2 s of a finger on a vibrating plate.

    Args:
        friction: coefficient as a function of the vibration amplitude in µm.
        largest_um: largest amplitude.
    """
    time = np.arange(round(_STROKES * _STROKE_S * _RATE_HZ)) / _RATE_HZ
    amplitude = largest_um / 2 * (1 - np.cos(2 * np.pi * MODULATION_HZ * time))
    leftwards = np.floor(time / _STROKE_S) % 2 == 0
    within = time % _STROKE_S
    position = np.where(leftwards, _REACH - _SPEED * within, _SPEED * within)
    normal = FORCE_N * (1 + 0.1 * np.sin(2 * np.pi * 0.7 * time))
    tangential = np.where(leftwards, 1, -1) * friction(amplitude) * normal
    noise = _NOISE_N * np.random.default_rng(0x7B10).standard_normal((2, time.size))
    signals = (time, normal + noise[0], tangential + noise[1], position, 1e-6 * amplitude)
    edges = torch.linspace(signals[-1].min(), np.nextafter(signals[-1].max(), np.inf), _BINS + 1, dtype=torch.float64)
    at, down, along, place, envelope = (torch.from_numpy(signal) for signal in signals)
    epochs = friction_epochs(at, down, along, place, envelope, edges, modulation_hz=MODULATION_HZ)
    return TribometerTrace(*signals, epochs)


def draw_trace(axes: Sequence[Axes], trace: TribometerTrace) -> None:
    """Draw figure S1 A into four axes: forces, friction ratio, position and vibration amplitude over time."""
    ratio = np.abs(trace.tangential) / np.where(trace.normal > 0, trace.normal, np.nan)
    forces, coefficient, place, envelope = axes
    for values, name, style in zip(
        (trace.normal, trace.tangential), ("normal", "tangential"), line_styles(2), strict=True
    ):
        forces.plot(trace.time, values, linewidth=0.8, label=name, **style)
    coefficient.plot(trace.time, ratio, color=INK, linewidth=0.8)
    place.plot(trace.time, 1e3 * trace.position, color=GREEN, linewidth=1)
    envelope.plot(trace.time, 1e6 * trace.amplitude, color=GREY, linewidth=0.8)
    count = len(trace.epochs.start)
    forces.set(ylabel="force (N)")
    coefficient.set(ylabel="|T| / N", ylim=(0, _axis_limit(ratio)))
    place.set(ylabel="finger (mm)")
    envelope.set(ylabel="vibration (µm)", xlabel="time (s)", ylim=(0, None))
    for one in axes:
        for start, stop in zip(trace.epochs.start.tolist(), trace.epochs.stop.tolist(), strict=True):
            one.axvspan(trace.time[start], trace.time[stop - 1], color=YELLOW, alpha=0.3, linewidth=0)
        one.label_outer()
        finished(one)
    forces.set_title(f"{count} epochs: leftwards, envelope rising", loc="left")
    forces.legend(frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1, 1))
    describe(
        forces,
        "Normal and tangential force, their ratio, position of the finger and amplitude of the vibration during one "
        f"trace; yellow: n = {count} epochs in which the finger slides leftwards while the amplitude rises.",
    )


def draw_friction(axes: Axes, epochs: FrictionEpochs) -> Axes:
    """Draw figure S1 B: friction coefficient against vibration amplitude (µm), one grey line per sliding epoch (one
    rise of the amplitude), with median and quartiles over the epochs.
    """
    middles = 1e6 * ((epochs.edges[1:] + epochs.edges[:-1]) / 2).numpy()
    for medians in epochs.median.numpy():
        axes.plot(middles, medians, color=GREY, linewidth=0.6, alpha=0.5)
    median, spread, count = (part.numpy() for part in epochs.over_epochs())
    axes.errorbar(middles, median, spread / 2, fmt="o-", color=INK, markersize=4, capsize=3)
    top = _axis_limit(epochs.median.numpy())
    axes.set(xlabel="vibration amplitude (µm)", ylabel="friction coefficient", ylim=(0, top))
    axes.set_title(f"{count.max()} epochs")
    return finished(
        axes,
        "Friction coefficient |T|/N against the amplitude of the vibration. Grey: median of each epoch. Dots: median "
        f"over epochs; bars: lower to upper quartile. n = {count.max()} epochs.",
    )


def _axis_limit(values: Values) -> float:
    """Return 1.2 times the 0.99 quantile of values, so that outliers do not set the limit of an axis."""
    return 1.2 * float(np.quantile(values[np.isfinite(values)], 0.99))
