"""Reader of frames in HDF5 files: one data set (N, H, W), with frame rate and bit depth as attributes."""

from contextlib import ExitStack
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fingerflow.errors import FingerflowError
from fingerflow.recordings.forces.open_forces import SAME_RATE, TO_SECONDS
from fingerflow.recordings.frames.recording import Description, FrameFile, Frames, Recording, grey_dtype
from fingerflow.recordings.guard.checked_hdf5 import check_stored_size, number_attribute, open_input, read_whole
from fingerflow.recordings.guard.file_checks import reading

CHUNK_CACHE_BYTES = 64 * 2**20  # a chunk often holds several frames and should be unpacked only once
_TIMES = ("time", "times", "timestamp", "timestamps", "t")  # names of data sets, without "frame" and underscores
NEVER_WRITTEN = "was never written"


def open_frames(path: Path, dataset: str = "") -> Recording:
    """Open the frames of an HDF5 file: the data set `dataset`, or the only one with three dimensions.

    Attributes are read from the data set, else from the groups that contain it. HDF5 returns its fill value for chunks
    that were never written: frames with such a chunk are unreadable, and missing after the last complete frame.

    Raises FingerflowError, naming the data sets, if the choice is ambiguous; and where the frames are in other files
    that are missing, or cannot be in this one by its size.
    """
    with ExitStack() as opened, reading(path, "HDF5"):
        file = opened.enter_context(open_input(path, rdcc_nbytes=CHUNK_CACHE_BYTES))
        description, frames = _describe(path, file, dataset)
        opened.pop_all()
    return Recording(description, FrameFile(description, partial(_frame, frames), file.close))


def _frame(frames: h5py.Dataset, index: int) -> Frames:
    """Return frame `index` (H, W) of an HDF5 data set (N, H, W); raise HDF5's error if it holds only fill values
    because a chunk cannot be read.
    """
    frame: Frames = frames[index]
    if frames.chunks is not None and not frames.is_virtual and np.any(unset := frame == frames.fillvalue):
        step, height, width = frames.chunks
        for row, column in product(range(0, frame.shape[0], height), range(0, frame.shape[1], width)):
            if unset[row : row + height, column : column + width].all():
                frames.id.read_direct_chunk((index - index % step, row, column))
    return frame


def _describe(path: Path, file: h5py.File, dataset: str) -> tuple[Description, h5py.Dataset]:
    frames = _chosen(path, file, dataset)
    check_stored_size(frames, path)
    stated, depth = _attribute(path, frames, "frame_rate"), _attribute(path, frames, "bit_depth")
    dtype = grey_dtype(frames.dtype, path)
    if depth is not None and not 1 <= depth <= 8 * dtype.itemsize:
        raise FingerflowError(f"{path}: attribute bit_depth is {depth} for pixels of type {dtype}")
    lacking = _incomplete_frames(path, frames)
    count = len(lacking) - int(np.argmin(lacking[::-1]))  # number of frames up to the last complete one
    stamps, rate, warnings = _time_stamps(path, frames, stated)
    description = Description(
        path=path,
        count=count,
        stated_count=len(lacking),
        frame_shape=frames.shape[1:],
        dtype=dtype,
        bit_depth=None if depth is None else int(depth),
        frame_rate=rate,
        time_stamps=None if stamps is None else stamps[:count],
        warnings=warnings,
        metadata={"dataset": frames.name},
        unreadable={int(index): NEVER_WRITTEN for index in np.flatnonzero(lacking[:count])},
    )
    return description, frames


def _time_stamps(path: Path, frames: h5py.Dataset, rate: float | None) -> tuple[Any, float | None, tuple[str, ...]]:
    """Return times (N,) s of frames from the data set beside them that holds one time a frame, or None if these are
    evenly spaced or there are none; the frame rate; and warnings.
    """
    for name in frames.parent:
        *words, last = name.lower().split("_")
        if last not in TO_SECONDS:
            words.append(last)
        item = frames.parent.get(name) if "".join(words).removeprefix("frame") in _TIMES else None
        if not isinstance(item, h5py.Dataset) or not 1 < item.size == len(frames):
            continue
        if item.dtype.kind not in "iuf":
            return None, rate, (f"the times of frames in {item.name} are no numbers, and are not used",)
        unit = item.attrs.get("units", item.attrs.get("unit", last))
        seconds = TO_SECONDS.get(unit.decode("latin-1") if isinstance(unit, bytes) else str(unit))
        values = read_whole(item, path).ravel().astype(np.float64 if item.dtype.kind == "f" else np.int64)
        stamps = (values - values[0]) * (seconds or 1.0)
        steps = np.diff(stamps)
        if not (np.isfinite(stamps).all() and np.all(steps > 0)):
            return None, rate, (f"the times of frames in {item.name} do not increase, and are not used",)
        measured = 1.0 / float(np.median(steps))
        if seconds is None and not (rate and abs(measured / rate - 1) <= SAME_RATE):
            unused = f"the times of frames in {item.name} are not used, as their attribute units states none of"
            return None, rate, (f"{unused} {', '.join(TO_SECONDS)}",)
        even = np.max(np.abs(stamps * measured - np.arange(len(stamps)))) <= SAME_RATE
        warning = f"the file states {rate} Hz, and the times in {item.name} are {measured:g} Hz apart; the times count"
        return None if even else stamps, measured, (warning,) * bool(rate and abs(measured / rate - 1) > SAME_RATE)
    return None, rate, ()


def _chosen(path: Path, file: h5py.File, name: str) -> h5py.Dataset:
    datasets: dict[str, h5py.Dataset] = {}
    file.visititems(lambda key, item: datasets.update({f"/{key}": item}) if isinstance(item, h5py.Dataset) else None)
    listing = ", ".join(f"{key} {item.shape} {item.dtype}" for key, item in datasets.items()) or "none"
    if name:
        # Look up the name directly, as `visititems` does not list the names of links.
        item = file.get("/" + name.strip("/"))
        if not isinstance(item, h5py.Dataset):
            raise FingerflowError(f"{path}: has no data set {name!r}; its data sets are {listing}")
        datasets = {name: item}
    stacks = [item for item in datasets.values() if item.ndim == 3 and item.dtype.kind in "uif" and 0 not in item.shape]
    if len(stacks) == 1:
        return stacks[0]
    if stacks:
        choice = f"{', '.join(item.name for item in stacks)}. Choose one, for example {path}::{stacks[0].name}"
        raise FingerflowError(f"{path}: has {len(stacks)} data sets that could be frames: {choice}")
    colour = " Colour frames have to be made grey first." if any(item.ndim == 4 for item in datasets.values()) else ""
    raise FingerflowError(
        f"{path}: has no frames, a data set (N, H, W) of numbers; its data sets are {listing}.{colour}"
    )


def _incomplete_frames(path: Path, frames: h5py.Dataset) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return a mask (N,) that is True for each frame of which the file lacks a chunk (block in which HDF5 stores a data
    set).

    File and data set must have been checked before.
    """
    lacking = np.zeros(frames.shape[0], bool)
    if frames.chunks is None or frames.is_virtual:
        return lacking
    grid = [-(-length // chunk) for length, chunk in zip(frames.shape, frames.chunks, strict=True)]
    if frames.id.get_num_chunks() == np.prod(grid, dtype=object):
        return lacking
    written = np.zeros(grid[0], np.int64)
    step = frames.chunks[0]

    def count(chunk: Any) -> None:
        written[chunk.chunk_offset[0] // step] += 1

    frames.id.chunk_iter(count)
    lacking[:] = np.repeat(written < grid[1] * grid[2], step)[: len(lacking)]
    if lacking.all():
        raise FingerflowError(f"{path}: not one frame of {frames.name} {frames.shape} was written whole; copy it again")
    return lacking


def _attribute(path: Path, item: h5py.Dataset, name: str) -> float | None:
    node: h5py.Dataset | h5py.Group = item
    while (value := number_attribute(node, name, path)) is None and node.name != "/":
        node = node.parent
    return value
