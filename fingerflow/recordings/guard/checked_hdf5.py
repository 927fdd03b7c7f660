"""Opening of HDF5 files only after a child process has traversed the file without a crash."""

import os
from itertools import product
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fingerflow.errors import FingerflowError, first_line
from fingerflow.recordings.guard.child_process import check_in_child_process
from fingerflow.recordings.guard.file_checks import plausible_size, reading
from fingerflow.schema.text_file import check_file

KIND = "HDF5"
MARK = "fingerflow_version"  # attribute that identifies a file of results


def open_hdf5(path: Path, **options: Any) -> h5py.File:
    """Open an HDF5 file for reading, after a child process has traversed the file without a crash.

    Raises FingerflowError where the file cannot be opened, or where traversing it ended that process (see
    :func:`check_in_child_process`).
    """
    check_file(path)
    check_in_child_process(path, "hdf5")
    with reading(path, KIND):
        return h5py.File(path, "r", **options)


def open_input(path: Path, **options: Any) -> h5py.File:
    """Open an HDF5 file as `open_hdf5` does; raise FingerflowError also if it is a result."""
    file = open_hdf5(path, **options)
    if MARK in file.attrs:
        file.close()
        raise FingerflowError(f"{path}: is a result of fingerflow; name a recording or a force file, not a result")
    return file


def number_attribute(item: h5py.Group | h5py.Dataset, name: str, path: Path) -> float | None:
    """Return an HDF5 attribute as a number, or None if it is missing; raise FingerflowError for any other value."""
    if name not in item.attrs:
        return None
    value = np.asarray(item.attrs[name])
    if value.size != 1 or value.dtype.kind not in "iuf":
        raise FingerflowError(f"{path}: attribute {name} of {item.name} is {value!r}; it should be one number")
    return float(value.item())


def check_stored_size(values: h5py.Dataset, path: Path) -> None:
    """Check that a file is large enough for all values that an HDF5 data set claims, before memory is allocated.

    Raises FingerflowError where its values were never written, end beyond the file, or lie in other files that are
    missing: HDF5 itself silently returns zeros for these.
    """
    again = "copy or export the file again"
    with reading(path, KIND):
        claimed, stored, size = values.size * values.dtype.itemsize, values.id.get_storage_size(), path.stat().st_size
        if values.is_virtual:
            return _sources_there(values, path)
        if values.external:
            for name, offset, length in values.external:
                file, needed = path.parent / os.fsdecode(name), offset + length
                there = file.stat().st_size if file.is_file() else -1
                if there < needed:
                    state = "is not there" if there < 0 else f"has {there} of {needed} bytes"
                    raise FingerflowError(
                        f"{path}: the values of {values.name} lie in {file}, which {state}; copy it beside this file"
                    )
            return
        if claimed and not stored:
            raise FingerflowError(f"{path}: {values.name} {values.shape} was created but never written; {again}")
        offset = values.id.get_offset()
        ends_late = offset is not None and offset + stored > size
        fits = stored >= claimed if values.chunks is None else plausible_size(claimed, min(stored, size))
        if ends_late or stored > 2 * size or not fits:
            raise FingerflowError(
                f"{path}: {values.name} {values.shape} should have {claimed} bytes, and the file of {size} cannot hold "
                f"them; {again}"
            )


def read_whole(values: h5py.Dataset, path: Path) -> np.ndarray[Any, Any]:
    """Return all values of an HDF5 data set; raise FingerflowError if a chunk of the data set was never written."""
    check_stored_size(values, path)
    if values.chunks is not None and not values.is_virtual:
        for at in product(*(range(0, length, step) for length, step in zip(values.shape, values.chunks, strict=True))):
            try:
                values.id.read_direct_chunk(at)
            except (OSError, RuntimeError) as error:
                raise FingerflowError(
                    f"{path}: {values.name} {values.shape} has no values from {at} on ({first_line(error)}); copy the "
                    "file again, or export it again"
                ) from error
    return np.asarray(values[()])


def _sources_there(values: h5py.Dataset, path: Path) -> None:
    for source in values.virtual_sources():
        name = source.file_name
        if name == ".":
            continue
        # HDF5 searches an external path as written, then beside the file; "%b" stands for the number of a block.
        pattern = name.replace("%b", "*")
        files = [file for file in (Path(pattern), path.parent / pattern, path.parent / Path(pattern).name)
                 if (file.exists() if "*" not in pattern else any(file.parent.glob(file.name)))]  # fmt: skip
        if not files:
            raise FingerflowError(
                f"{path}: the values of {values.name} lie in {name}, which is not there; copy it beside this file"
            )
        if "*" not in pattern and "%" not in source.dset_name:
            with open_hdf5(files[0]) as holder:
                if source.dset_name not in holder:
                    raise FingerflowError(
                        f"{path}: the values of {values.name} lie in {source.dset_name} of {files[0]}, which is not in "
                        "it; copy that file again"
                    )
