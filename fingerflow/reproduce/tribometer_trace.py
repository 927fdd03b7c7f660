"""Simulated tribometer trace of a finger that slides back and forth on a plate with modulated vibration amplitude."""

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fingerflow.report.tribometer import TribometerTrace, read_tribometer
from fingerflow.results.atomic_write import write_atomically

Values = NDArray[np.float64]
MODULATION_HZ, FORCE_N = 4.0, 0.5  # printed frequency of the modulation and printed normal force
_RATE_HZ, _STROKES, _STROKE_S = 1000, 6, 2.0
_SPEED, _REACH = 0.05, 0.1  # m/s and m, speed and length of a stroke
_NOISE_N = 1e-3  # N, standard deviation of a sample


def write_trace(path: Path, friction: Callable[[Values], Values], largest_um: float) -> TribometerTrace:
    """Simulate a tribometer trace, six strokes of 2 s of a finger on a vibrating plate, write it as CSV unless the file
    exists, and return the trace in the file.

    Args:
        path: of the file; one that is there is kept.
        friction: coefficient as a function of the vibration amplitude in µm.
        largest_um: largest amplitude.
    """
    if not path.exists():
        draw = np.random.default_rng(0x7B10)
        time = np.arange(round(_STROKES * _STROKE_S * _RATE_HZ)) / _RATE_HZ
        amplitude = largest_um / 2 * (1 - np.cos(2 * np.pi * MODULATION_HZ * time))
        leftwards = np.floor(time / _STROKE_S) % 2 == 0
        within = time % _STROKE_S
        position = np.where(leftwards, _REACH - _SPEED * within, _SPEED * within)
        normal = FORCE_N * (1 + 0.1 * np.sin(2 * np.pi * 0.7 * time))
        tangential = np.where(leftwards, 1, -1) * friction(amplitude) * normal
        noise = _NOISE_N * draw.standard_normal((2, time.size))
        columns = (time, normal + noise[0], tangential + noise[1], 1e3 * position, amplitude)
        text = io.StringIO()
        head = "time (s),normal (N),tangential (N),position (mm),amplitude (um)"
        np.savetxt(text, np.column_stack(columns), delimiter=",", header=head, comments="", fmt="%.6g")
        write_atomically(path, lambda part: part.write_text(text.getvalue(), encoding="utf-8"))
    return read_tribometer(path)
