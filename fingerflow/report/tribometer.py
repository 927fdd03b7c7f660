"""Sliding friction from a tribometer trace: reading of the file, and figures S1 A and B of Willemet et al. 2021."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
import torch
from matplotlib.axes import Axes
from torch import Tensor

from fingerflow.errors import FingerflowError
from fingerflow.models.friction_epochs import FrictionEpochs, friction_epochs
from fingerflow.plot.axes_style import GREEN, GREY, INK, YELLOW, finished, line_styles
from fingerflow.plot.captions import describe
from fingerflow.recordings import open_forces

#: Signals of a trace, with the units to which they are converted.
SIGNALS = {"normal": "N", "tangential": "N", "position": "m", "amplitude": "m"}
BINS = 6  # number of amplitude bins: the paper has six levels besides zero amplitude
_MOST_POINTS = 20_000  # largest number of points of a line, more than any figure resolves


@dataclass(frozen=True)
class TribometerTrace:
    """Recording, in T samples, of a finger sliding to and fro on a plate whose vibration amplitude is modulated:
    forces, finger position and vibration amplitude; float64, SI units.
    """

    path: Path
    time: Tensor  # (T,) s, time
    normal: Tensor  # (T,) N, normal force, positive in compression
    tangential: Tensor  # (T,) N, tangential force
    position: Tensor  # (T,) m, position of the finger, growing to the right
    amplitude: Tensor  # (T,) m, envelope of the vibration

    def epochs(self, modulation_hz: float = 4.0) -> FrictionEpochs:
        """Return the friction coefficients of the trace in six bins of vibration amplitude, for each epoch: a half
        period of the modulation, in which the amplitude rises.

        Raises:
            FingerflowError: the trace cannot be divided into epochs.
        """
        low, high = float(self.amplitude.min()), float(self.amplitude.max())
        edges = torch.linspace(low, np.nextafter(high, np.inf), BINS + 1, dtype=torch.float64)
        signals = (self.time, self.normal, self.tangential, self.position, self.amplitude)
        try:
            return friction_epochs(*signals, edges, modulation_hz=modulation_hz)
        except ValueError as error:
            raise FingerflowError(f"{self.path}: {error}") from None


def read_tribometer(
    path: str | PathLike[str], columns: Mapping[str, str] | None = None, units: Mapping[str, str] | None = None
) -> TribometerTrace:
    """Read a tribometer trace from a force file (CSV, HDF5, .mat or .tdms).

    Args:
        path: CSV or other delimited text, HDF5, `.mat` or `.tdms`.
        columns: names of the columns in the file for "normal", "tangential", "position", "amplitude" and "time"; a
            signal left out has its own name there.
        units: units of columns, by their names in the file, if the file does not state them: N, mN ...; m, mm, um ...

    Raises:
        FingerflowError: an unknown signal, a signal that is not in N or m, or as in `open_forces`.
    """
    given = dict(columns or {})
    strange = sorted(set(given) - {*SIGNALS, "time"})
    if strange:
        raise FingerflowError(
            f"{path}: a trace has no signal {', '.join(map(repr, strange))}; name {', '.join(SIGNALS)} or time"
        )
    time = given.pop("time", None)
    names = {signal: given.get(signal, signal) for signal in SIGNALS}
    lengths = [names[signal] for signal, unit in SIGNALS.items() if unit == "m"]
    forces = open_forces(path, channels=names, units=units, time=time, lengths=lengths)
    for signal, unit in SIGNALS.items():
        if forces.units[signal] != unit:
            raise FingerflowError(
                f"{forces.path}: {signal}, column {names[signal]!r}, is in {forces.units[signal]}: multiply it by the "
                f"sensor's sensitivity and give it in {unit}"
            )
    signals = {signal: torch.from_numpy(np.array(forces.channels[signal])) for signal in SIGNALS}
    return TribometerTrace(forces.path, torch.from_numpy(np.array(forces.times)), **signals)


def draw_trace(axes: Sequence[Axes], trace: TribometerTrace, epochs: FrictionEpochs) -> Sequence[Axes]:
    """Draw figure S1 A into four axes: forces, friction ratio, position and vibration amplitude over time."""
    step = max(1, len(trace.time) // _MOST_POINTS)
    time, normal, tangential, position, amplitude = (
        signal[::step].numpy()
        for signal in (trace.time, trace.normal, trace.tangential, trace.position, trace.amplitude)
    )
    pressed = normal > 0
    ratio = np.where(pressed, np.abs(tangential) / np.where(pressed, normal, 1), np.nan)
    forces, coefficient, place, envelope = axes
    normal_style, tangential_style = line_styles(2)
    forces.plot(time, normal, linewidth=0.8, label="normal", **normal_style)
    forces.plot(time, tangential, linewidth=0.8, label="tangential", **tangential_style)
    coefficient.plot(time, ratio, color=INK, linewidth=0.8)
    place.plot(time, 1e3 * position, color=GREEN, linewidth=1)
    envelope.plot(time, 1e6 * amplitude, color=GREY, linewidth=0.8)
    for one in axes:
        for start, stop in zip(epochs.start.tolist(), epochs.stop.tolist(), strict=True):
            edges = float(trace.time[start]), float(trace.time[stop - 1])
            one.axvspan(*edges, color=YELLOW, alpha=0.3, linewidth=0)
        one.label_outer()
    count = len(epochs.start)
    forces.set(ylabel="force (N)", title=f"{count} epoch{'s' * (count != 1)}: leftwards, envelope rising")
    coefficient.set(ylabel="|T| / N", ylim=(0, _axis_limit(ratio)))
    place.set(ylabel="finger (mm)")
    envelope.set(ylabel="vibration (µm)", xlabel="time (s)", ylim=(0, None))
    for one in axes:
        finished(one)
    low, high = forces.get_ylim()
    forces.set_ylim(low, high + 0.5 * (high - low))  # leaves space for the legend
    forces.legend(frameon=False, ncols=2, loc="upper right")
    describe(
        forces,
        "Normal and tangential force, their ratio, position of the finger and amplitude of the vibration during one "
        f"trace; yellow: n = {count} epochs in which the finger slides leftwards while the amplitude rises.",
    )
    return axes


def draw_friction(axes: Axes, epochs: FrictionEpochs) -> Axes:
    """Draw figure S1 B: friction coefficient against vibration amplitude (µm), one grey line per sliding epoch (one
    rise of the amplitude), with median and quartiles over the epochs.
    """
    middles = 1e6 * ((epochs.edges[1:] + epochs.edges[:-1]) / 2).numpy()
    for medians in epochs.median.numpy():
        axes.plot(middles, medians, color=GREY, linewidth=0.6, alpha=0.5)
    median, spread, count = (part.numpy() for part in epochs.over_epochs())
    name = f"median and quartiles of {int(count.max(initial=0))} epochs"
    axes.errorbar(middles, median, spread / 2, fmt="o-", color=INK, markersize=4, capsize=3, label=name)
    axes.set(
        xlabel="vibration amplitude (µm)", ylabel="friction coefficient", ylim=(0, _axis_limit(epochs.median.numpy()))
    )
    return finished(
        axes,
        "Friction coefficient |T|/N against the amplitude of the vibration. Grey: median of each epoch. Dots: median "
        f"over epochs; bars: lower to upper quartile. n = {int(count.max(initial=0))} epochs.",
    )


def _axis_limit(values: np.ndarray) -> float | None:
    """Return an upper axis limit for values, 1.2 times their 0.99 quantile, so that outliers do not set it; None
    without finite values.
    """
    known = values[np.isfinite(values)]
    return 1.2 * float(np.quantile(known, 0.99)) if known.size else None
