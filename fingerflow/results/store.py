"""Storage of result variables during a run: in memory, or in a file that grows frame by frame."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, Self

import h5py
import numpy as np
import xarray as xr
from h5py import h5s
from numpy.typing import NDArray

from fingerflow.results.free_space import check_disk, check_memory, check_write
from fingerflow.schema.variable_record import LABELS, Variable
from fingerflow.schema.variables import TIME

_GROWING = "point"  # dimension that may grow after a variable is created
_CHUNK_BYTES = 1 << 20  # bytes, chunk cache of HDF5 for one variable
# Largest factor by which a frame of a growing variable may grow: three times the points, in chunks that are not full
# (`pipeline.stages.tracking.tracking_stage`). If a row of chunks were larger than the cache, it would be written and
# read again with every batch.
_MOST_GROWTH = 4
_CHUNK_FRAMES = 64  # number of frames in a chunk: as many as stages read at a time; HDF5 caches smaller batches
# Least bytes of a frame for storage in chunks, which have an overhead. Only integers are compressed: most bits of
# positions and strains are noise, and gzip takes longer than all kernels to halve their size.
_FEWEST_BYTES = 256
_CHUNK_GROWING = 256  # chunk length along a growing dimension, so that a few more points do not double the file


class Values(Protocol):
    """Interface of the array that holds a result variable, indexed along the first axis by a slice or by consecutive
    numbers.
    """

    @property
    def shape(self) -> tuple[int, ...]: ...

    def __getitem__(self, index: Any) -> NDArray[Any]: ...

    def __setitem__(self, index: Any, values: Any) -> None: ...


class Store(ABC):
    """Container of result variables during a run, which pipeline stages write to and read from.

    A variable is created once, when the sizes of its dimensions are known, and then filled frame by frame. Values that
    are not written yet are NaN, or 0 for integers.
    """

    def __init__(self, variables: Mapping[str, Variable], frames: int) -> None:
        """Prepare an empty store for a number of `frames`; only these `variables` may be created in it."""
        self._variables = variables
        self._sizes = {"frame": frames} | {name: len(labels) for name, labels in LABELS.items()}
        self._values: dict[str, Values] = {}

    def create(self, name: str, attributes: Mapping[str, Any] | None = None, **sizes: int) -> Values:
        """Create a result variable in the store, filled with NaN or 0, and return its array; `sizes` gives the lengths
        of dimensions that are new to the store.
        """
        self._sizes.update(sizes)
        variable = self._variables[name]
        of_it = {**variable.attributes(), **(attributes or {})}
        values = self._values[name] = self._new(variable, tuple(self._sizes[dim] for dim in variable.dims), of_it)
        return values

    def put(self, name: str, values: Any, attributes: Mapping[str, Any] | None = None, **sizes: int) -> None:
        """Create the result variable `name` in the store and write all of its values; `sizes` gives the lengths of
        dimensions that are new to the store.
        """
        self.create(name, attributes, **sizes)[:] = values

    def grow(self, points: int, fills: Mapping[str, float]) -> None:
        """Enlarge the dimension `point` of all variables to a number of `points`; new elements take the value that
        `fills` gives for the variable, else NaN, or 0 for integers.
        """
        before, self._sizes[_GROWING] = self._sizes[_GROWING], points
        for name in list(self._values):
            if _GROWING in self._variables[name].dims:
                self._lengthen(name, self._variables[name].dims.index(_GROWING), before, points, fills.get(name))

    def __getitem__(self, name: str) -> Values:
        return self._values[name]

    def __contains__(self, name: str) -> bool:
        return name in self._values

    @abstractmethod
    def _new(self, variable: Variable, shape: tuple[int, ...], attributes: dict[str, Any]) -> Values: ...

    @abstractmethod
    def _lengthen(self, name: str, axis: int, before: int, size: int, fill: float | None) -> None: ...

    @abstractmethod
    def check_room(self, needed: float) -> None:
        """Raise NoRoomError if `needed` more bytes of results do not fit into memory or on the disk."""

    @abstractmethod
    def finish(self, time: NDArray[np.float64], frame: NDArray[np.integer], attributes: Mapping[str, Any]) -> None:
        """Add the times (s) and numbers of the frames and the global attributes to the results, after which nothing
        more may be written.
        """


class MemoryStore(Store):
    """Store that keeps all variables in memory, and collects them in the data set `dataset` at the end."""

    dataset: xr.Dataset

    def __init__(self, variables: Mapping[str, Variable], frames: int) -> None:
        super().__init__(variables, frames)
        self._attributes: dict[str, dict[str, Any]] = {}

    def _new(self, variable: Variable, shape: tuple[int, ...], attributes: dict[str, Any]) -> Values:
        self._attributes[variable.name] = attributes
        return np.full(shape, *_fill(variable))

    def _lengthen(self, name: str, axis: int, before: int, size: int, fill: float | None) -> None:
        values, empty = self._values[name], _fill(self._variables[name])[0]
        widths = [(0, (size - before) * (k == axis)) for k in range(len(values.shape))]
        self._values[name] = np.pad(values[:], widths, constant_values=empty if fill is None else fill)

    def check_room(self, needed: float) -> None:
        check_memory(needed)

    def finish(self, time: NDArray[np.float64], frame: NDArray[np.integer], attributes: Mapping[str, Any]) -> None:
        described = self._attributes.items()
        arrays = {name: (self._variables[name].dims, self._values[name], about) for name, about in described}
        self.dataset = labelled(arrays, time, frame, attributes)


def labelled(
    arrays: Mapping[str, Any], time: NDArray[Any], frame: NDArray[Any], attributes: Mapping[str, Any]
) -> xr.Dataset:
    """Return a result data set of variables, each as dimensions, values and attributes, with the times (s) and numbers
    of its frames and the labels of the dimensions.
    """
    used = {dim for dims, _, _ in arrays.values() for dim in dims}
    coordinates = {"time": (TIME.dims, time, TIME.attributes()), "frame": frame}
    labels = {name: list(labels) for name, labels in LABELS.items() if name in used}
    return indexed_by_time(xr.Dataset(arrays, {**coordinates, **labels}, dict(attributes)))


def indexed_by_time(result: xr.Dataset) -> xr.Dataset:
    """Return a result whose frames can also be selected by time, s: ``result.sel(time=0.25, method="nearest")``."""
    return result.set_xindex("time") if "time" in result.coords else result


class FileStore(Store):
    """Store that writes variables to an HDF5/NetCDF4 file, so that memory use does not grow with the number of frames.

    Dimension scales of NetCDF-4 are written in `finish`: attaching them with each variable takes longer than writing
    the numbers of a small recording.
    """

    def __init__(self, variables: Mapping[str, Variable], frames: int, path: Path) -> None:
        super().__init__(variables, frames)
        check_write(path, 0)
        self._path = path
        self._file = h5py.File(path, "w", track_order=True)
        self._dims: dict[str, tuple[str, ...]] = {}
        self._datasets: dict[str, h5py.Dataset] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def _new(self, variable: Variable, shape: tuple[int, ...], attributes: dict[str, Any]) -> Values:
        fill, dtype = _fill(variable)
        if dtype == "?":  # as xarray writes truth values, which NetCDF has not
            dtype, attributes = "u1", {**attributes, "dtype": "bool"}
        layout: dict[str, Any] = {"fillvalue": fill} if np.dtype(dtype).kind == "f" else {}
        sides = list(zip(variable.dims, shape, strict=True))
        if _GROWING in variable.dims:
            layout["maxshape"] = tuple(None if dim == _GROWING else size for dim, size in sides)
        frame_bytes = int(np.prod(shape[1:])) * np.dtype(dtype).itemsize
        if variable.dims[0] == "frame" and frame_bytes >= _FEWEST_BYTES:
            held = frame_bytes * (_MOST_GROWTH if "maxshape" in layout else 1)
            frames = min(max(shape[0], 1), max(1, _CHUNK_BYTES // held), _CHUNK_FRAMES)
            layout["chunks"] = (frames, *(min(n, _CHUNK_GROWING) if dim == _GROWING else n for dim, n in sides[1:]))
            if np.dtype(dtype).kind != "f":
                layout |= {"compression": "gzip", "compression_opts": 2, "shuffle": True}
        stored = self._add(variable.name, variable.dims, shape=shape, dtype=dtype, **layout)
        if layout.get("fillvalue") is not None:
            attributes = {"_FillValue": np.full(1, fill, dtype), **attributes}
        if "frame" in variable.dims:
            attributes = {**attributes, "coordinates": "time"}
        _describe(stored, attributes)
        return _Stored(stored, self._path, variable.dtype)

    def _lengthen(self, name: str, axis: int, before: int, size: int, fill: float | None) -> None:
        values = self._values[name]
        assert isinstance(values, _Stored)
        values.resize(size, axis)
        if fill is not None:
            for first in range(0, values.shape[0], _CHUNK_FRAMES):
                chunk = slice(first, first + _CHUNK_FRAMES)
                rows = values[chunk]
                rows[(slice(None),) * axis + (slice(before, None),)] = fill
                values[chunk] = rows

    def check_room(self, needed: float) -> None:
        check_disk(self._path, needed)

    def finish(self, time: NDArray[np.float64], frame: NDArray[np.integer], attributes: Mapping[str, Any]) -> None:
        self._add("frame", ("frame",), data=frame)
        _describe(self._add("time", ("frame",), data=time), TIME.attributes())
        for name, labels in LABELS.items():
            if any(name in dims for dims in self._dims.values()):
                self._add(name, (name,), data=np.array(labels, dtype=h5py.string_dtype()))
        self._add_scales()
        _describe(self._file, attributes)

    def _add(self, name: str, dims: tuple[str, ...], **what: Any) -> h5py.Dataset:
        self._dims[name] = dims
        self._datasets[name] = self._file.create_dataset(name, track_order=True, **what)
        return self._datasets[name]

    def _add_scales(self) -> None:
        """Write the dimensions of all variables as HDF5 dimension scales (H5DS) and NetCDF-4 dimensions."""
        used = dict.fromkeys(dim for dims in self._dims.values() for dim in dims)
        numbers = {dim: np.int32(number) for number, dim in enumerate(used)}
        scales: dict[str, h5py.Dataset] = {}
        for dim, number in numbers.items():
            size = self._sizes[dim]
            if dim in self._datasets:
                scales[dim], label = self._datasets[dim], dim
            else:
                # Give the dimension a fixed size, as nothing grows any more. For an unlimited dimension h5netcdf
                # queries all its variables repeatedly, which takes longer than the rest of opening the file.
                scales[dim] = self._file.create_dataset(dim, (size,), ">f4", track_order=True)
                label = f"This is a netCDF dimension but not a netCDF variable. {size:>10d}"
            scales[dim].make_scale(label)
            _describe(scales[dim], {"_Netcdf4Dimid": number})
        for name, dims in self._dims.items():
            stored = self._datasets[name]
            _describe(stored, {"_Netcdf4Coordinates": np.array([numbers[dim] for dim in dims])})
            if name not in scales:
                _describe(stored, {"_Netcdf4Dimid": numbers[dims[0]]})
                for axis, dim in enumerate(dims):
                    stored.dims[axis].attach_scale(scales[dim])
        versions = f"version=2,h5py={h5py.__version__},hdf5={h5py.version.hdf5_version}"
        self._file.attrs["_NCProperties"] = np.bytes_(versions.encode())


def _describe(stored: h5py.Dataset | h5py.File, attributes: Mapping[str, Any]) -> None:
    """Write attributes of a variable or file in NetCDF form, as texts or arrays of numbers."""
    for name, value in attributes.items():
        stored.attrs[name] = value if isinstance(value, (str, np.generic)) else np.atleast_1d(value)


class _Stored:
    """Array of a variable in an HDF5 file, which reads and writes runs of consecutive frames in ascending or descending
    order.
    """

    def __init__(self, variable: h5py.Dataset, path: Path, dtype: str) -> None:
        self._variable, self._path, self._dtype, self.shape = variable, path, dtype, tuple(variable.shape)

    def resize(self, size: int, axis: int) -> None:
        """Change the length of an axis of the array."""
        self._variable.resize(size, axis)
        self.shape = tuple(self._variable.shape)

    def __getitem__(self, index: Any) -> NDArray[Any]:
        frames, step = self._consecutive(index)
        return self._variable[frames][::step].astype(self._dtype, copy=False)

    def __setitem__(self, index: Any, values: Any) -> None:
        frames, step = self._consecutive(index)
        shape = (frames.stop - frames.start, *self.shape[1:])
        block = np.broadcast_to(np.asarray(values, self._variable.dtype), shape)
        check_write(self._path, block.nbytes)
        if block.size:
            # Call HDF5 directly: h5py's indexing takes three times as long for the few frames of a batch.
            part = self._variable.id.get_space()
            part.select_hyperslab((frames.start, *(0,) * (len(shape) - 1)), shape)
            self._variable.id.write(h5s.create_simple(shape), part, np.ascontiguousarray(block[::step]))

    def _consecutive(self, index: Any) -> tuple[slice, int]:
        """Convert consecutive frame numbers, given as a slice or a list, to an ascending slice and a step: 1 if they
        ascend, -1 if they descend.
        """
        numbers = range(self.shape[0])[index] if isinstance(index, slice) else np.asarray(index, dtype=int).tolist()
        if not len(numbers):
            return slice(0, 0), 1
        first, last = numbers[0], numbers[-1]
        step = 1 if last >= first else -1
        if list(numbers) != list(range(first, last + step, step)):
            raise IndexError(
                f"frames {list(numbers)} are not consecutive: a file is read and written by runs of frames"
            )
        return slice(min(first, last), max(first, last) + 1), step


def _fill(variable: Variable) -> tuple[float, str]:
    """Return fill value and data type for the elements of the array of a variable that are not written yet."""
    return (np.nan if variable.dtype.startswith("f") else 0), variable.dtype
