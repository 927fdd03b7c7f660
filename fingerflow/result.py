"""Files of results: HDF5/NetCDF4, CSV and .mat."""

from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
import xarray as xr

from fingerflow.atomic_write import keep_others, write_atomically
from fingerflow.errors import FingerflowError
from fingerflow.room import check_write
from fingerflow.untrusted import check_by_walking, check_file, first_line, open_hdf5, reading

MARK = "fingerflow_version"  # the attribute by which a result is known
_TABLE_BEGINS = b"frame,time (s)"


def save_result(result: xr.Dataset, path: Path, overwrite: bool = False) -> None:
    """Writes HDF5/NetCDF4; the file appears only when it is complete.

    Raises FingerflowError where it cannot be written, as on a disk without as much room as the result takes in memory,
    and without `overwrite` where a file is there that is no result.
    """
    keep_others(path, is_result, overwrite)
    check_write(path, result.nbytes)
    compressed = {name: {"zlib": True, "complevel": 2} for name, values in result.data_vars.items() if values.ndim > 1}
    write_atomically(path, lambda part: result.to_netcdf(part, engine="h5netcdf", encoding=compressed))


def load_result(path: Path) -> xr.Dataset:
    """Reads what :func:`save_result` or `process` wrote.

    Raises FingerflowError where the file is missing or is something else.
    """
    with open_result(path) as stored, reading(path, "a result"):
        return stored.load()


def is_table(path: Path) -> bool:
    """Whether a file is what :func:`export_table` writes: by its first columns, or the variables of them all."""
    try:
        if path.suffix == ".mat":
            return {"time", "frame", "units"} <= {name for name, _, _ in scipy.io.whosmat(str(path))}
        with path.open("rb") as file:
            return file.read(len(_TABLE_BEGINS)) == _TABLE_BEGINS
    except Exception:  # whatever SciPy raises at a file that is none
        return False


def is_result(path: Path) -> bool:
    """Whether a file is what :func:`save_result` or `process` writes."""
    try:
        with open_hdf5(path) as file:
            return MARK in file.attrs
    except FingerflowError:
        return False


def open_result(path: Path) -> xr.Dataset:
    """As :func:`load_result`, but values are read from the file when they are looked at; close it when done."""
    check_file(path)
    check_by_walking(path, "hdf5")
    try:
        result = xr.open_dataset(path, engine="h5netcdf")
    except Exception as error:  # whatever the library raises at a damaged file
        raise FingerflowError(
            f"{path} cannot be read as a result ({first_line(error)}); run `fingerflow process` again"
        ) from error
    if MARK not in result.attrs:
        result.close()
        raise FingerflowError(
            f"{path} is not a result of fingerflow: it does not state a {MARK}; name the file that `fingerflow "
            "process` wrote"
        )
    return result


def export_table(result: xr.Dataset, path: Path, overwrite: bool = False) -> None:
    """Writes a table: .csv with one row a frame and one column a quantity, or .mat with every variable.

    Raises FingerflowError for another suffix, and without ``overwrite`` where a file is there that is no such table.
    """
    keep_others(path, is_table, overwrite)
    if path.suffix == ".csv":
        columns = {}
        for name, values in {"time": result["time"], **result.data_vars}.items():
            if values.dims == ("frame",):
                columns[f"{name} ({values.attrs['units']})"] = values.values
            elif (
                len(values.dims) == 2
                and values.dims[0] == "frame"
                and values.dims[1] in ("xy", "axis", "strain_component")
            ):
                for k, part in enumerate(result[values.dims[1]].values):
                    columns[f"{name}_{part} ({values.attrs['units']})"] = values.values[:, k]
        rows = np.column_stack([result["frame"].values, *columns.values()])
        header = ",".join(["frame", *columns])
        write_atomically(
            path, lambda part: np.savetxt(part, rows, delimiter=",", fmt="%.9g", header=header, comments="")
        )
    elif path.suffix == ".mat":
        content: dict[str, Any] = {str(name): values.values for name, values in result.data_vars.items()}
        content["time"] = result["time"].values
        content["frame"] = result["frame"].values
        content["units"] = {str(name): values.attrs["units"] for name, values in result.data_vars.items()}

        def write(part: Path) -> None:
            with part.open("wb") as file:
                scipy.io.savemat(file, content, do_compression=True, long_field_names=True)

        write_atomically(path, write)
    else:
        raise FingerflowError(f"{path}: a table is written as .csv or .mat, not {path.suffix or 'without a suffix'!r}")
