"""Forces in a MATLAB file, v5 to v7.3: every numeric vector is a column, fields of a struct as struct.field."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.recordings.forces.table import Table
from fingerflow.untrusted import check_by_walking, reading

RATE_NAMES = ("sample_rate", "fs")
UNITS = "units"


def read_table(path: Path) -> Table:
    """A scalar `sample_rate` or `fs` is the rate in Hz; a struct `units` has the unit of each column by its name."""
    try:
        from pymatreader import read_mat
    except ImportError:
        raise FingerflowError(
            f'{path}: MATLAB files need the package pymatreader; install it with pip install "fingerflow-engine[mat]"'
        ) from None
    check_by_walking(path, "MATLAB")
    table = Table(path, {})
    with reading(path, "a MATLAB file"):
        _take(table, read_mat(str(path)), "")
    return table


def _take(table: Table, content: Mapping[str, Any], prefix: str) -> None:
    for key, value in content.items():
        if key.startswith("__") or key == "#refs#":
            continue
        name = prefix + key
        if isinstance(value, Mapping) and key == UNITS:
            table.units.update({prefix + column: str(unit) for column, unit in value.items()})
        elif isinstance(value, Mapping):
            _take(table, value, name + ".")
        elif (numbers := _numbers(value)) is None:
            continue
        elif numbers.size == 1:
            if key in RATE_NAMES:
                table.sample_rate = float(numbers.reshape(-1)[0])
        elif numbers.size:
            table.add(name, numbers)


def _numbers(value: Any) -> NDArray[Any] | None:
    """None for texts, and for cells, which hold vectors of several lengths."""
    try:
        numbers = np.asarray(value)
    except ValueError:
        return None
    return numbers if numbers.dtype.kind in "iuf" else None
