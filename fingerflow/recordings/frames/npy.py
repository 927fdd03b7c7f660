"""Reader of frames in a memory-mapped NumPy file: an array (N, H, W), or (H, W) for a single frame."""

from pathlib import Path
from typing import Literal

import numpy as np

from fingerflow.errors import FingerflowError, first_line
from fingerflow.recordings.frames.recording import Description, FrameFile, Recording, grey_dtype, surplus
from fingerflow.recordings.guard.claimed_sizes import MOST_NPY_HEADER, npy_header_bytes


def open_frames(path: Path) -> Recording:
    """Open the frames of a NumPy file, reading the header only; raise FingerflowError unless shape and type suit grey
    frames.
    """
    with open(path, "rb") as file:
        length = npy_header_bytes(file.read(12))
        if length > MOST_NPY_HEADER:
            raise FingerflowError(f"{path}: its header should have {length} bytes, and no array has; save it again")
        file.seek(0)
        try:
            version = np.lib.format.read_magic(file)
            read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[version]
            shape, by_columns, dtype = read(file)
        except Exception as error:  # NumPy does not specify what an invalid header raises
            raise FingerflowError(
                f"{path}: not a NumPy file of plain numbers ({first_line(error)}); copy or save it again"
            ) from None
        start = file.tell()
    dtype = grey_dtype(dtype, path)
    if len(shape) not in (2, 3) or min(shape) < 1:
        colour = " Colour frames have to be made grey first." if len(shape) == 4 else ""
        raise FingerflowError(f"{path}: its array is {shape}; frames are (N, H, W), or (H, W) for one.{colour}")
    count, height, width = shape if len(shape) == 3 else (1, *shape)
    frame_bytes, stored = height * width * dtype.itemsize, path.stat().st_size - start
    available = stored // frame_bytes
    if available == 0 or (by_columns and available < count):
        raise FingerflowError(f"{path}: {path.stat().st_size} bytes are too few for its {count} frames; copy it again")
    whole = min(count, available)
    order: Literal["F", "C"] = "F" if by_columns else "C"  # (H, W) and (1, H, W) have the same bytes in either order
    frames = np.asarray(np.memmap(path, dtype, "r", start, (whole, height, width), order))
    description = Description(
        path=path,
        count=whole,
        stated_count=count,
        frame_shape=(height, width),
        dtype=dtype,
        warnings=surplus(stored - count * frame_bytes, frame_bytes, count),
    )
    return Recording(description, FrameFile(description, frames))
