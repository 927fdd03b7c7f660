"""What the deviations of medians hold: presses at several frame rates, `process` with default settings, truth by
formulas.

The fewer frames a second, the more is missing before the first frame that shows contact. Rows of frames with a median
and a truth, some eighty a press: `error` in 1e-3, its mean and RMS; `z` is the error over the stated deviation. Those
that hold it have an RMS of one, 68 % of the frames within one deviation and 95 % within two; neighbouring frames err
alike, so a press is few trials.

Energy, in uJ, is compared with that of the skin in the triangles that it is summed over, from 10 mm2 of contact on;
`of_contact` is the last frame's over that of all skin in contact.
"""

import tempfile
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bench.contact_grid import energy_since_onset
from bench.rows import Row
from bench.suites.pipeline import QUICK_PRESS, write_quietly
from fingerflow import process
from fingerflow.synthetic import Press

RATES, QUICK_RATES = (40.0, 60.0, 300.0), (24.0,)  # Hz, of presses of a second
MEDIANS = ("divergence", "curl")
_LOOKED_AT, _ENERGIES = 80, 20  # frames
_STEP_MM = 0.1


def run(quick: bool) -> list[Row]:
    """One row a frame rate and quantity."""
    rows: list[Row] = []
    for rate in QUICK_RATES if quick else RATES:
        press = QUICK_PRESS if quick else Press(n_frames=int(rate), frame_rate=rate)
        with tempfile.TemporaryDirectory() as folder:
            write_quietly(Path(folder) / "press", press)
            result = process(Path(folder) / "press" / "scene.toml")
        rows += [
            {"frame_rate_hz": press.frame_rate, "quantity": name, **_of_median(result, press, name)} for name in MEDIANS
        ]
        rows.append({"frame_rate_hz": press.frame_rate, "quantity": "energy", **_of_energy(result, press)})
    return rows


def _of_median(result: xr.Dataset, press: Press, name: str) -> Row:
    frames = np.arange(0, press.n_frames, max(1, press.n_frames // _LOOKED_AT))
    true = np.array([getattr(press.truth.medians(int(k)), name) for k in frames])
    return _stated(result, f"median_{name}", frames, true)


def _of_energy(result: xr.Dataset, press: Press) -> Row:
    frames = np.arange(press.n_frames - 1, 0, -max(1, press.n_frames // _ENERGIES))
    frames = frames[[press.truth.gross_contact_area_mm2(int(k)) > 10 for k in frames]]
    true = np.array([energy_since_onset(press, result, int(k), _STEP_MM) for k in frames])
    of_contact = float(result["strain_energy"].values[frames[0]] / true[0, 0])
    return {**_stated(result, "strain_energy", frames, true[:, 1]), "of_contact": of_contact}


def _stated(result: xr.Dataset, name: str, frames: NDArray[np.intp], true: NDArray[np.float64]) -> Row:
    error = result[name].values[frames] - true
    stated = result[f"{name}_std"].values[frames]
    known = np.isfinite(error) & (stated > 0)
    error, z = 1e3 * error[known], error[known] / stated[known]
    return {
        "frames": int(known.sum()),
        "error_mean": float(error.mean()),
        "error_rms": float(np.sqrt(np.mean(error**2))),
        "stated_median": 1e3 * float(np.median(stated[known])),
        "z_rms": float(np.sqrt(np.mean(z**2))),
        "z_worst": float(np.abs(z).max()),
        "within_1": float(np.mean(np.abs(z) < 1)),
        "within_2": float(np.mean(np.abs(z) < 2)),
    }
