"""Export of results to MATLAB files, with indices that count from 1."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
import xarray as xr

from fingerflow.results.atomic_write import write_atomically

_ABOUT = (
    "Points in `triangles`, and frames in `frame`, `key_frame` and `onset_frame` (0 for a point that never touches), "
    "count from 1, frames from the first in the file of the recording: position(frame == onset_frame(k), k, :). "
    "`meanings` has those of the values 0, 1, 2 ... of a status: strsplit(meanings.status); `components` the names "
    "along the last dimension."
)
_COUNTED = ("frame", "onset_frame", "key_frame", "triangles")  # indices from 0 in a data set


def save_matlab(result: xr.Dataset, path: Path) -> None:
    """Write a result to a .mat file: all variables, and structs of units, definitions, meanings of statuses, names of
    components, attributes, settings and warnings.
    """
    variables = {str(name): values for name, values in {**result.data_vars, **result.coords}.items()}
    content: dict[str, Any] = {
        name: values.values + (name in _COUNTED) for name, values in variables.items() if values.dtype.kind in "iufb"
    }
    for name, attribute in (("units", "units"), ("definitions", "long_name"), ("meanings", "flag_meanings")):
        content[name] = {key: values.attrs[attribute] for key, values in variables.items() if attribute in values.attrs}
    content["components"] = {
        name: variables[str(values.dims[-1])].values.astype(object)
        for name, values in variables.items()
        if values.ndim > 1 and str(values.dims[-1]) in variables
    }
    attributes = dict(result.attrs)
    content["settings"] = _for_matlab(json.loads(attributes.pop("settings", "{}")))
    content["warnings"] = np.array(json.loads(attributes.pop("warnings", "[]")), dtype=object)
    content["attributes"], content["about"] = attributes, _ABOUT

    def write(part: Path) -> None:
        with part.open("wb") as file:
            scipy.io.savemat(file, content, do_compression=True, long_field_names=True)

    write_atomically(path, write)


def _for_matlab(value: Any) -> Any:
    """Convert nested dictionaries to nested MATLAB structs, with an empty array in place of None."""
    if isinstance(value, dict):
        return {name: _for_matlab(entry) for name, entry in value.items()}
    return np.zeros((0, 0)) if value is None else value
