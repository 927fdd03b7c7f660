"""Reader of forces in HDF5 files, in which every vector is a column; units and sample rate come from attributes."""

from pathlib import Path

import h5py

from fingerflow.errors import FingerflowError
from fingerflow.recordings.forces.force_table import ForceTable
from fingerflow.recordings.guard.checked_hdf5 import number_attribute, open_hdf5, open_input, read_whole
from fingerflow.recordings.guard.file_checks import reading


def read_table(path: Path) -> ForceTable:
    """Return all numeric vectors and columns of tables in an HDF5 file as columns, each named by the path in the file.

    `sample_rate` (Hz) is an attribute of the file, a group or a data set; two different ones are an error. Values are
    multiplied by `scale_factor` (netCDF) or `conversion` (NWB), then `add_offset` is added.
    """
    table = ForceTable(path, {})
    rates = set()
    with open_input(path) as file, reading(path, "HDF5"):

        def take(name: str, item: h5py.Group | h5py.Dataset) -> None:
            if (rate := number_attribute(item, "sample_rate", path)) is not None:
                rates.add(rate)
            if isinstance(item, h5py.Dataset) and item.ndim == 1 and item.dtype.names:
                rows = read_whole(item, path)
                for field in item.dtype.names:
                    if item.dtype[field].kind in "iuf":
                        table.add(f"{name}/{field}", rows[field])
            if isinstance(item, h5py.Dataset) and item.dtype.kind in "iuf" and item.ndim in (1, 2):
                unit = item.attrs.get("units", item.attrs.get("unit"))
                factor = number_attribute(item, "scale_factor", path) or number_attribute(item, "conversion", path) or 1
                offset = number_attribute(item, "add_offset", path) or 0
                values = factor * read_whole(item, path) + offset
                table.add(name, values, unit.decode("latin-1") if isinstance(unit, bytes) else unit)

        take("/", file)
        file.visititems(take)
    if len(rates) > 1:
        raise FingerflowError(
            f"{path}: states several sample rates ({', '.join(map(str, sorted(rates)))} Hz); give sample_rate in Hz"
        )
    table.sample_rate = rates.pop() if rates else None
    return table


def dimensions(path: Path) -> list[int]:
    """Return the number of dimensions of each data set in an HDF5 file."""
    sizes: list[int] = []
    with open_hdf5(path) as file:
        file.visititems(lambda _, item: sizes.append(item.ndim) if isinstance(item, h5py.Dataset) else None)
    return sizes
