"""Reading and writing of result files in HDF5/NetCDF4 format."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import h5py
import xarray as xr

from fingerflow.errors import FingerflowError, first_line
from fingerflow.recordings.guard.checked_hdf5 import MARK as MARK
from fingerflow.recordings.guard.checked_hdf5 import open_hdf5
from fingerflow.recordings.guard.child_process import check_in_child_process
from fingerflow.recordings.guard.file_checks import reading
from fingerflow.results.atomic_write import keep_others, write_atomically
from fingerflow.results.free_space import check_write
from fingerflow.results.store import indexed_by_time
from fingerflow.results.stream_folder import MASKS
from fingerflow.schema.text_file import check_file

_OF_NETCDF = {
    *("CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST", "coordinates", "dtype"),
    *("_FillValue", "_NCProperties", "_Netcdf4Coordinates", "_Netcdf4Dimid"),
}


def save_result(result: xr.Dataset, path: Path, overwrite: bool = False) -> None:
    """Write a result, a data set as `process` returns it, to an HDF5/NetCDF4 file, which appears under the final name
    only when complete.

    Raises FingerflowError where it cannot be written, for example if the disk has less free space than the result takes
    in memory, and without `overwrite` where the path is an existing file that is no result.
    """
    keep_others(path, is_result, overwrite)
    check_write(path, result.nbytes)
    compressed = {name: {"zlib": True, "complevel": 2} for name, values in result.data_vars.items() if values.ndim > 1}
    write_atomically(path, lambda part: result.to_netcdf(part, engine="h5netcdf", encoding=compressed))


def load_result(path: Path) -> xr.Dataset:
    """Read a result file, written by :func:`save_result` or `process`, completely into memory.

    Raises FingerflowError where the file is missing or is something else.
    """
    with open_result(path) as stored, reading(path, "a result"):
        return stored.load()


def is_result(path: Path) -> bool:
    """Return whether a file was written by :func:`save_result` or `process`."""
    try:
        with open_hdf5(path) as file:
            return MARK in file.attrs
    except FingerflowError:
        return False


def open_result(path: Path) -> xr.Dataset:
    """Open a result without loading values, which are read on access; close the data set after use.

    It is a file of `process`, or a Zarr store that `fingerflow export-table` has written.
    """
    if path.suffix == ".zarr":
        return open_own(path)
    if not path.exists():
        raise FingerflowError(f"{path}: there is no such result; `fingerflow process` of a scene file writes it")
    check_file(path)
    check_in_child_process(path, "hdf5")
    return open_own(path)


def read_own(path: Path, names: Iterable[str], described: Iterable[str]) -> xr.Dataset:
    """Read the variables `names` of a result file that this process itself wrote, and its frame numbers and times;
    variables that the file lacks are left out.

    Attributes are read only of the variables named in `described`, and dimensions of none. Values and texts are those
    of :func:`load_result`, which opens every variable of the file first; for a small recording that takes longer than a
    stage.
    """
    with h5py.File(path) as file:
        stored = [(name, file[name]) for name in dict.fromkeys((*names, "time", "frame")) if name in file]
        about = {name: _attributes(file[name]) for name in described if name in file}
        variables = {
            name: ([f"{name} {axis}" for axis in range(dataset.ndim)], dataset[()], about.get(name, {}))
            for name, dataset in stored
        }
        return xr.Dataset(variables, attrs=_attributes(file))


def open_own(path: Path) -> xr.Dataset:
    """Open a result file that this process itself wrote, without the checks for damage of :func:`open_result`."""
    try:
        store: dict[str, Any] = {"engine": "zarr", "consolidated": False} if path.suffix == ".zarr" else {}
        result = xr.open_dataset(path, **{"engine": "h5netcdf", **store})
        masks = [name for name in MASKS if name in result and result[name].dtype != bool]
        result.update({name: result[name].astype(bool) for name in masks})
    except Exception as error:  # a damaged file may raise any exception
        raise FingerflowError(
            f"{path} cannot be read as a result ({first_line(error)}); run `fingerflow process` again"
        ) from error
    if MARK not in result.attrs:
        result.close()
        raise FingerflowError(
            f"{path} is not a result of fingerflow: it does not state a {MARK}; name the file that `fingerflow "
            "process` wrote"
        )
    return indexed_by_time(result)


def _attributes(stored: h5py.Dataset | h5py.File) -> dict[str, Any]:
    return {name: stored.attrs[name] for name in stored.attrs if name not in _OF_NETCDF}


def scene_of(path: Path) -> Path:
    """Return the path of the scene file with which the result in the file `path` was computed.

    Raises FingerflowError where the file is no result, or its scene file does not exist any more.
    """
    with open_result(path) as stored:
        scene = Path(json.loads(stored.attrs.get("settings", "{}")).get("path", ""))
    if not scene.is_file():
        raise FingerflowError(f"{path}: its scene {scene} is not there any more; name the scene file")
    return scene
