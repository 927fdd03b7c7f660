"""Reader of forces in HDF5 files: every vector is a column; attributes `units` (or `unit`) and `sample_rate`."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from fingerflow.errors import FingerflowError
from fingerflow.recordings.forces.table import ForceTable
from fingerflow.recordings.guard.files import reading
from fingerflow.recordings.guard.hdf5 import open_hdf5, stored_whole


def read_table(path: Path) -> ForceTable:
    """Return the columns of a file, named by their path in it without the leading slash.

    `sample_rate` (Hz) is an attribute of the file, a group or a data set; two different ones are an error.
    """
    table = ForceTable(path, {})
    rates: set[float] = set()
    with open_hdf5(path) as file, reading(path, "HDF5"):
        _take_rate(path, file, rates)

        def take(name: str, item: h5py.Group | h5py.Dataset) -> None:
            _take_rate(path, item, rates)
            if isinstance(item, h5py.Dataset) and item.dtype.kind in "iuf" and item.ndim in (1, 2):
                stored_whole(item, path)
                table.add(name, item[()])
                unit = item.attrs.get("units", item.attrs.get("unit"))
                if unit is not None:
                    units = unit.decode("latin-1") if isinstance(unit, bytes) else str(unit)
                    table.units.update({column: units for column in table.columns if column.split("[")[0] == name})

        file.visititems(take)
    if len(rates) > 1:
        raise FingerflowError(
            f"{path}: states several sample rates ({', '.join(map(str, sorted(rates)))} Hz); pass sample_rate="
        )
    table.sample_rate = rates.pop() if rates else None
    return table


def _take_rate(path: Path, item: h5py.Group | h5py.Dataset, rates: set[float]) -> None:
    if "sample_rate" in item.attrs:
        value = np.asarray(item.attrs["sample_rate"])
        if value.size != 1 or value.dtype.kind not in "iuf":
            raise FingerflowError(f"{path}: attribute sample_rate is {value!r}; it should be one number, in Hz")
        rates.add(float(value.reshape(-1)[0]))
