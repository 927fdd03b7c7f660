"""Export of results to MATLAB files, with indices that count from 1."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
import xarray as xr

from fingerflow.results.atomic_write import write_atomically

_ABOUT = (
    "Numbers of points in `triangles`, and of rows of frames in `onset_frame`, count from 1 (0 for a point that never "
    "touches): position(onset_frame(k), k, :). `frame` has the frames' numbers in the file of the recording, from 0."
)


def save_matlab(result: xr.Dataset, path: Path) -> None:
    """Write a result to a .mat file: all variables, and structs of units, definitions, settings and warnings."""
    content: dict[str, Any] = {str(name): values.values for name, values in result.data_vars.items()}
    content["time"], content["frame"] = result["time"].values, result["frame"].values
    if "triangles" in content:
        content["triangles"] = content["triangles"] + 1
    if "onset_frame" in content:
        onset, first = content["onset_frame"], result["frame"].values[0]
        content["onset_frame"] = np.where(onset < 0, 0, onset - first + 1).astype(onset.dtype)
    content["units"] = {str(name): values.attrs["units"] for name, values in result.data_vars.items()}
    content["definitions"] = {str(name): values.attrs["long_name"] for name, values in result.data_vars.items()}
    content["settings"] = _for_matlab(json.loads(result.attrs.get("settings", "{}")))
    content["warnings"] = np.array(json.loads(result.attrs.get("warnings", "[]")), dtype=object)
    content["about"] = _ABOUT

    def write(part: Path) -> None:
        with part.open("wb") as file:
            scipy.io.savemat(file, content, do_compression=True, long_field_names=True)

    write_atomically(path, write)


def _for_matlab(value: Any) -> Any:
    """Convert nested dictionaries to nested MATLAB structs, with an empty array in place of None."""
    if isinstance(value, dict):
        return {name: _for_matlab(entry) for name, entry in value.items()}
    return np.zeros((0, 0)) if value is None else value
