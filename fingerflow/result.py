"""Files of results: HDF5/NetCDF4."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import h5py
import xarray as xr

from fingerflow.atomic_write import keep_others, write_atomically
from fingerflow.errors import FingerflowError
from fingerflow.room import check_write
from fingerflow.untrusted import check_by_walking, check_file, first_line, open_hdf5, reading

_OF_NETCDF = {
    *("CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST", "coordinates"),
    *("_FillValue", "_NCProperties", "_Netcdf4Coordinates", "_Netcdf4Dimid"),
}
MARK = "fingerflow_version"  # the attribute by which a result is known


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
    return open_own(path)


def read_own(path: Path, names: Iterable[str]) -> xr.Dataset:
    """Those variables of a file that this process has just written, as far as it has them, and its attributes.

    Values, dimensions and texts are those of :func:`load_result`, which looks at every variable of the file first: of a
    small recording that takes longer than a stage.
    """
    with h5py.File(path) as file:
        found = [name for name in dict.fromkeys((*names, "time", "frame")) if name in file]
        variables = {name: _read(file[name]) for name in found}
        return xr.Dataset(variables, attrs=_attributes(file))


def open_own(path: Path) -> xr.Dataset:
    """As :func:`open_result`, of a file that this process has just written: no damage is expected in it."""
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


def _read(stored: h5py.Dataset) -> xr.Variable:
    dims = [dim[0].name.rpartition("/")[2] if len(dim) else stored.name.rpartition("/")[2] for dim in stored.dims]
    return xr.Variable(dims, stored[()], _attributes(stored))


def _attributes(stored: h5py.Dataset | h5py.File) -> dict[str, Any]:
    return {name: stored.attrs[name] for name in stored.attrs if name not in _OF_NETCDF}


def scene_of(path: Path) -> Path:
    """The scene file of which a file is the result.

    Raises FingerflowError where the file is no result, or that scene is not there any more.
    """
    with open_result(path) as stored:
        scene = Path(json.loads(stored.attrs.get("settings", "{}")).get("path", ""))
    if not scene.is_file():
        raise FingerflowError(f"{path}: its scene {scene} is not there any more; name the scene file")
    return scene
