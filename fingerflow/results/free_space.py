"""Checks that results fit in memory or on disk before they are written, since HDF5 ends the process on a full disk."""

import shutil
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import psutil

from fingerflow.errors import NoRoomError
from fingerflow.schema.variable_record import LABELS, Variable

# Least size of a file relative to `size_of_results`: floating-point data are not compressed, but the shipped press
# has only three quarters of the largest possible number of triangles.
_COMPRESSED = 0.7
_LEFT_BYTES = 64 << 20  # free space kept for data that HDF5 still buffers when it is closed
_GB = 1e9


def size_of_results(variables: Iterable[Variable], frames: int, points: int) -> float:
    """Return the memory, bytes, that result variables take for a number of frames and of tracked skin points.

    There are two triangles per point; the regions of cells are neglected.
    """
    sizes = {dim: len(names) for dim, names in LABELS.items()}
    sizes |= {"frame": frames, "point": points, "triangle": 2 * points}
    return float(
        sum(
            np.dtype(variable.dtype).itemsize * np.prod([sizes.get(dim, 1) for dim in variable.dims], dtype=float)
            for variable in variables
        )
    )


def check_memory(needed: float) -> None:
    """Raise NoRoomError if `needed` bytes of results do not fit in memory."""
    free = psutil.virtual_memory().available
    if needed > free:
        raise NoRoomError(
            f"the results take {needed / _GB:.2f} GB of memory, and {free / _GB:.2f} GB are free; write them to a file "
            f"(process(..., to=), which takes little memory), ask for fewer outputs, points or frames"
        )


def check_disk(path: Path, holds: float) -> None:
    """Raise NoRoomError if the disk lacks space for a result file with `holds` bytes of uncompressed content."""
    _check_free(path, _COMPRESSED * holds)


def check_write(path: Path, bytes_more: int) -> None:
    """Raise NoRoomError if the disk lacks space for `bytes_more` bytes plus the data that HDF5 still buffers."""
    _check_free(path, bytes_more + _LEFT_BYTES)


def _check_free(path: Path, needed: float) -> None:
    folder = path.parent
    try:
        free = shutil.disk_usage(folder).free
    except FileNotFoundError:
        folder = next((parent for parent in path.absolute().parents if parent.is_dir()), Path.cwd())
        free = shutil.disk_usage(folder).free
    if needed > free:
        raise NoRoomError(
            f"{folder.absolute()}: {needed / _GB:.2f} GB are needed and {free / _GB:.2f} GB of the disk are free; "
            f"nothing was left there. Make room, write to another disk, or ask for fewer outputs, points or frames"
        )
