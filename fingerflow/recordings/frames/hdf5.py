"""Frames in an HDF5 file: one data set (N, H, W); attributes `frame_rate` (Hz) and `bit_depth` where they are there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fingerflow.errors import FingerflowError
from fingerflow.recordings.frames.recording import Description, FileRecording, Frames, container_bits, grey_dtype

CHUNK_CACHE_BYTES = 64 * 2**20  # a chunk often spans several frames; it should be unpacked once, not once a frame


def open_frames(path: Path, frame_rate: float | None, dataset: str = "") -> Hdf5Recording:
    """Open the only data set of three dimensions, or the one that `dataset` names.

    The attributes are looked for at the data set, then at the groups around it. Raises FingerflowError, naming the data
    sets there are, if the choice is not clear.
    """
    try:
        file = h5py.File(path, "r", rdcc_nbytes=CHUNK_CACHE_BYTES)
    except OSError as error:
        raise FingerflowError(f"{path}: cannot be opened as HDF5, it is of another kind or damaged ({error})") from None
    try:
        frames = _chosen(path, file, dataset)
        rate, depth = _attribute(frames, "frame_rate"), _attribute(frames, "bit_depth")
        dtype = grey_dtype(frames.dtype, path)
        if rate is not None and not (np.isfinite(rate) and rate > 0):
            raise FingerflowError(f"{path}: attribute frame_rate is {rate}; it must be positive, or pass frame_rate=")
        if depth is not None and not 1 <= depth <= 8 * dtype.itemsize:
            raise FingerflowError(f"{path}: attribute bit_depth is {depth} for pixels of type {dtype}")
    except FingerflowError:
        file.close()
        raise
    description = Description(
        path=path,
        count=frames.shape[0],
        frame_shape=frames.shape[1:],
        dtype=dtype,
        bit_depth=int(depth) if depth is not None and dtype.kind == "u" else container_bits(dtype),
        frame_rate=rate,
        metadata={"dataset": frames.name},
    )
    return Hdf5Recording(description, frame_rate, frames)


class Hdf5Recording(FileRecording):
    """Frames read from the data set one at a time."""

    def __init__(self, description: Description, frame_rate: float | None, frames: h5py.Dataset) -> None:
        super().__init__(description, frame_rate)
        self._frames = frames

    def _read_frame(self, index: int) -> Frames:
        return np.asarray(self._frames[index], self.dtype)

    def close(self) -> None:
        self._frames.file.close()


def _chosen(path: Path, file: h5py.File, name: str) -> h5py.Dataset:
    found: dict[str, h5py.Dataset] = {}
    file.visititems(lambda key, item: found.update({f"/{key}": item}) if isinstance(item, h5py.Dataset) else None)
    listing = ", ".join(f"{key} {item.shape} {item.dtype}" for key, item in found.items()) or "none"
    if name:
        if "/" + name.strip("/") not in found:
            raise FingerflowError(f"{path}: has no data set {name!r}; its data sets are {listing}")
        found = {name: found["/" + name.strip("/")]}
    stacks = [item for item in found.values() if item.ndim == 3 and item.dtype.kind in "uif" and 0 not in item.shape]
    if len(stacks) == 1:
        return stacks[0]
    if stacks:
        raise FingerflowError(
            f"{path}: has {len(stacks)} data sets that could be frames: {', '.join(item.name for item in stacks)}. "
            f"Choose one, for example {path}::{stacks[0].name}"
        )
    colour = " Colour frames have to be made grey first." if any(item.ndim == 4 for item in found.values()) else ""
    raise FingerflowError(
        f"{path}: has no frames, a data set (N, H, W) of numbers; its data sets are {listing}.{colour}"
    )


def _attribute(item: h5py.Dataset, name: str) -> float | None:
    place: Any = item
    while True:
        if name in place.attrs:
            return float(np.asarray(place.attrs[name]).reshape(-1)[0])
        if place.name == "/":
            return None
        place = place.parent
