"""Table of a trial's main quantities, with uncertainty, at the frames that its report shows in detail."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fingerflow.report.key_frames import ReportFrame
from fingerflow.schema.rounding import format_uncertainty
from fingerflow.schema.variables import VARIABLES

_WINDOW = 11  # number of frames of the parabola fit
_DEGREES = 3  # number of coefficients of a parabola
_QUANTITIES = (
    "normal_force", "tangential_force", "load_ratio", "gross_contact_area", "real_contact_area", "contact_area_ratio",
    "stuck_ratio", "printed_stuck_ratio", "median_divergence", "median_curl", "global_displacement", "strain_energy",
)  # fmt: skip


def key_numbers(result: xr.Dataset, frames: Sequence[ReportFrame]) -> list[tuple[str, str, list[str]]]:
    """Return the rows of the table of key numbers, one per quantity (time, force, areas, divergence, energy and
    others): its name, its unit, and its value at each of the key frames `frames` ± one standard deviation as text.

    The standard deviation of divergence and curl includes `MedianBias` beside the errors of the points, that of
    energy the uncertainty of the border. For areas without one it is the scatter from frame to frame (`scatter`).
    """
    indices = [frame.frame for frame in frames]
    rows = [("time", "s", [f"{value:.3f}" for value in result["time"].values[indices]])]
    for name in _QUANTITIES:
        if name not in result or not np.isfinite(result[name].values).any():
            continue
        variable = VARIABLES[name]
        words, values = variable.words, variable.shown_values(result[name].values)
        if f"{name}_std" in result:
            spread = variable.shown_values(result[f"{name}_std"].values)
        elif name in ("gross_contact_area", "real_contact_area"):
            spread = scatter(values)
            words += " (± scatter)"
        else:
            spread = np.full(len(values), np.nan)
        cells = [format_uncertainty(float(values[k]), float(spread[k])) for k in indices]
        rows.append((words, variable.shown_unit.name, cells))
    return rows


def scatter(values: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return for each frame the standard deviation of a time series (F,) about a parabola fitted to the 11 frames
    around it.

    It measures how well a frame repeats its neighbours, not an error that they have in common. NaN if any is unknown.
    """
    deviations = np.full(len(values), np.nan)
    if len(values) < _WINDOW:
        return deviations
    positions = np.linspace(-1, 1, _WINDOW)
    left = np.eye(_WINDOW) - (basis := np.vander(positions, _DEGREES)) @ np.linalg.pinv(basis)
    windows = np.lib.stride_tricks.sliding_window_view(np.asarray(values, dtype=np.float64), _WINDOW)
    rest = np.sqrt(((windows @ left.T) ** 2).sum(1) / (_WINDOW - _DEGREES))
    half = _WINDOW // 2
    deviations[half : len(values) - half] = rest
    # Frames at the ends take the values of the first and last windows.
    deviations[:half], deviations[len(values) - half :] = rest[0], rest[-1]
    return deviations
