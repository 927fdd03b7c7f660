"""Reader of forces in MATLAB files, v5 to v7.3, in which every numeric vector is a column."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fingerflow.errors import FingerflowError
from fingerflow.recordings.forces.force_table import ForceTable
from fingerflow.recordings.guard.child_process import read_matlab_in_child_process
from fingerflow.recordings.guard.file_checks import reading

RATE_NAMES = ("sample_rate", "fs")
UNITS = "units"


def read_table(path: Path) -> ForceTable:
    """Return all numeric vectors of a MATLAB file as columns.

    A scalar `sample_rate` or `fs` is the rate in Hz; a struct `units` holds the unit of each column by its name.
    """
    try:
        import pymatreader  # noqa: F401  imported by another process
    except ImportError:
        raise FingerflowError(f"{path}: MATLAB files need the package pymatreader: pip install pymatreader") from None
    table = ForceTable(path, {})
    with reading(path, "a MATLAB file"):
        _take(table, read_matlab_in_child_process(path), "")
    return table


def _take(table: ForceTable, content: Mapping[str, Any], prefix: str) -> None:
    for key, value in content.items():
        if key.startswith("__") or key == "#refs#":
            continue
        name = prefix + key
        if isinstance(value, Mapping) and key == UNITS:
            table.units.update({prefix + column: str(unit) for column, unit in value.items()})
        elif isinstance(value, Mapping):
            _take(table, value, name + ".")
        elif isinstance(value, np.ndarray) and value.size == 1:
            if key in RATE_NAMES:
                table.sample_rate = float(value.reshape(-1)[0])
        elif isinstance(value, np.ndarray) and value.size:
            table.add(name, value)
