"""Layout of records: the variables of `schema` that are stored for each frame of a stream."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fingerflow.engines.engine import Array
from fingerflow.schema.variable_record import LABELS, Variable
from fingerflow.schema.variables import FRAME, TRACK_STATUS, VARIABLES
from fingerflow.tracker.frame_results import RESULTS

# Variables of a record that the player adds to those of the tracker.
_NUMBER = "number of the frame as it came in, or in its file, from 0; gaps are dropped frames"
_OF_STREAM = ("time", "latency", "frame_status", "key_frame", "restart", "contact_threshold")
_OWN = (Variable("frame", FRAME, "", _NUMBER, "i8"), *(VARIABLES[name] for name in _OF_STREAM))
_NOT_USABLE = TRACK_STATUS.index("frame_not_usable")
_MATLAB = {"f4": "single", "f8": "double", "u1": "uint8", "b1": "uint8", "u2": "uint16", "i4": "int32", "i8": "int64"}


def _entry(variable: Variable, dtype_code: str, shape: tuple[int, ...]) -> dict[str, Any]:
    """Return the description of one field of the records for the header of the results: name, type, dimensions, unit
    and definition; `shape` does not include the frame axis.
    """
    dtype = np.dtype(dtype_code).newbyteorder("<").str
    about = {"name": variable.name, "dtype": dtype, "shape": shape, "dims": variable.dims, "unit": variable.units}
    return {**about, "long_name": variable.long_name, "matlab": _MATLAB[dtype[1:]]}


class RecordLayout:
    """Layout of the records of a stream: one record a frame, with a field for each stored variable.

    Args:
        points: number N of points in each frame.
        forces: names of the forces that are known.

    Attributes:
        dtype: of a record.
        fields: entries of the header, one a field.
    """

    def __init__(self, points: int, forces: Sequence[str] = ()) -> None:
        sizes = {"point": points} | {name: len(labels) for name, labels in LABELS.items()}
        self.fields = [_entry(entry, entry.dtype, ()) for entry in (*_OWN, *(VARIABLES[name] for name in forces))]
        for variable in (VARIABLES[name] for name in RESULTS):
            # The tracker computes in single precision, so floats are stored with 4 bytes.
            dtype_code = "f4" if variable.dtype.startswith("f") else variable.dtype
            self.fields.append(_entry(variable, dtype_code, tuple(sizes[dim] for dim in variable.dims[1:])))
        self.dtype = np.dtype([(entry["name"], entry["dtype"], entry["shape"]) for entry in self.fields])

    def fill(self, records: Mapping[str, Array], index: int, results: Mapping[str, Array], frame: int) -> None:
        """Store the results of the frame with index `frame` in `results`, arrays by variable name, at index `index` of
        the arrays that `records` holds for each field.
        """
        for name in RESULTS:
            records[name][index] = results[name][frame]

    def fill_unknown(self, records: Mapping[str, Array], index: int) -> None:
        """Store a record of unknown values, for a frame without results, at index `index` of the arrays that `records`
        holds for each field.

        It is NaN, 0 in integer fields, and "frame_not_usable" as the status of points.
        """
        for name in RESULTS:
            records[name][index] = np.nan if records[name].dtype.kind == "f" else _NOT_USABLE if name == "status" else 0
