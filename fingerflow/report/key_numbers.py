"""Key numbers of a trial: main quantities at its key frames, with their uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fingerflow.report.telling_frames import Telling

_WINDOW = 11  # frames of the parabola fit
_DEGREES = 3  # degrees of freedom of a parabola


@dataclass(frozen=True)
class Line:
    """Row of the table: a quantity with its unit, and its value at each key frame as text; NaN is an en dash."""

    name: str
    unit: str
    values: tuple[str, ...]


def key_numbers(result: xr.Dataset, frames: Sequence[Telling]) -> list[Line]:
    """Return forces, areas, divergence, curl, displacement and energy at these frames, ± one standard deviation.

    The standard deviation of divergence and curl includes `MedianBias` beside the errors of the points, that of
    energy `border_energy`. For areas it is the scatter from frame to frame (`scatter`).
    """
    places = [one.frame for one in frames]
    lines = [Line("time", "s", tuple(f"{value:.3f}" for value in result["time"].values[places]))]
    for name, variable, unit, factor in (
        ("normal force", "normal_force", "N", 1.0),
        ("tangential force", "tangential_force", "N", 1.0),
        ("T/N", "load_ratio", "", 1.0),
        ("gross contact area", "gross_contact_area", "mm²", 1.0),
        ("real contact area", "real_contact_area", "mm²", 1.0),
        ("real over gross area", "contact_area_ratio", "", 1.0),
        ("stuck share of the contact", "stuck_ratio", "", 1.0),
        ("share that has slipped", "slip_ratio", "", 1.0),
        ("median divergence", "median_divergence", "µm/mm", 1000.0),
        ("median curl", "median_curl", "µm/mm", 1000.0),
        ("median displacement", "global_displacement", "µm", 1000.0),
        ("strain energy", "strain_energy", "mJ", 1.0),
    ):
        if variable not in result or not np.isfinite(result[variable].values).any():
            continue
        values = factor * result[variable].values
        if f"{variable}_std" in result:
            spread = factor * result[f"{variable}_std"].values
        elif variable in ("gross_contact_area", "real_contact_area"):
            spread = scatter(values)
            name += " (± scatter)"
        else:
            spread = np.full(len(values), np.nan)
        told = tuple(with_uncertainty(float(values[k]), float(spread[k])) for k in places)
        lines.append(Line(name, unit, told))
    return lines


def scatter(values: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the standard deviation (F,) from a parabola fitted to the 11 frames around; NaN if any is unknown.

    It measures how well a frame repeats its neighbours, not an error that they have in common.
    """
    found = np.full(len(values), np.nan)
    if len(values) < _WINDOW:
        return found
    place = np.linspace(-1, 1, _WINDOW)
    left = np.eye(_WINDOW) - (basis := np.vander(place, _DEGREES)) @ np.linalg.pinv(basis)
    windows = np.lib.stride_tricks.sliding_window_view(np.asarray(values, dtype=np.float64), _WINDOW)
    rest = np.sqrt(((windows @ left.T) ** 2).sum(1) / (_WINDOW - _DEGREES))
    half = _WINDOW // 2
    found[half : len(values) - half] = rest
    # Frames at the ends have the values of the first and last windows.
    found[:half], found[len(values) - half :] = rest[0], rest[-1]
    return found


def with_uncertainty(value: float, spread: float) -> str:
    """Return "value ± spread", rounded to two digits of the spread; three digits of the value without a spread.

    >>> with_uncertainty(33.4123, 0.5178)
    '33.41 ± 0.52'
    """
    if not np.isfinite(value):
        return "–"
    if not np.isfinite(spread) or spread <= 0:
        return _rounded(value, 2 - int(np.floor(np.log10(abs(value)))) if value else 0)
    digits = 1 - int(np.floor(np.log10(spread)))
    return f"{_rounded(value, digits)} ± {_rounded(spread, digits)}"


def _rounded(value: float, digits: int) -> str:
    return f"{round(value, digits) + 0.0:.{max(digits, 0)}f}"
