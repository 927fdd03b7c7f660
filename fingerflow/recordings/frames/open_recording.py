"""Opening of recordings, with a separate reader for each file format."""

import os
from importlib import import_module
from os import PathLike
from pathlib import Path

from fingerflow.errors import FingerflowError
from fingerflow.recordings.frames.recording import Recording, possible_rate
from fingerflow.recordings.guard.file_checks import reading
from fingerflow.schema.text_file import check_file

# File suffixes by reader. Readers are imported on first use, as video and HDF5 libraries take a second to load.
READERS = {
    "cine": (".cine",),
    "mraw": (".mraw", ".cih", ".cihx"),
    "tiff": (".tif", ".tiff"),
    "video": (".avi", ".mp4", ".mkv", ".mov"),
    "hdf5": (".h5", ".hdf5"),
    "npy": (".npy",),
    "images": (".png", ".jpg", ".jpeg", ".bmp"),
}
_READER_OF = {suffix: reader for reader, suffixes in READERS.items() for suffix in suffixes}


def open_recording(path: str | PathLike[str], frame_rate: float | None = None) -> Recording:
    """Open a recording of any supported format without reading frames.

    path: a Phantom `.cine`, either file of a Photron `.mraw` / `.cih` pair, a TIFF stack, a video, an HDF5 file
        (`file.h5` or `file.h5::/group/data set`), a `.npy`, a folder of images, or one image: a recording of one frame.
    frame_rate: Hz; replaces the rate and the time stamps of the file. Without it, a file that states no rate has none.

    Raises FingerflowError for a file that is missing, of an unknown kind, in colour, with a damaged header or without a
    complete frame. A file that only ends too early opens with its complete frames and a sentence in `warnings`; a frame
    that is damaged by itself is listed in `unreadable`.
    """
    if frame_rate is not None and not possible_rate(frame_rate):
        raise FingerflowError(f"{path}: frame_rate={frame_rate} was given; it must lie between 1e-06 and 1e+09 Hz")
    file, _, inside = str(path).partition("::")
    location = Path(file)
    # `isdir` returns False, without an error, if permission is missing.
    reader = "images" if os.path.isdir(location) else _READER_OF.get(location.suffix.lower())
    if reader is None:
        check_file(location)
        known = f"Known are a folder of images and {', '.join(_READER_OF)}"
        raise FingerflowError(f"{location}: {location.suffix or 'a file without suffix'} is not a recording. {known}")
    if inside and reader != "hdf5":
        raise FingerflowError(f"{path}: only an HDF5 file has something after '::'")
    if reader != "images":
        check_file(location)
    module = import_module(f"fingerflow.recordings.frames.{reader}")
    with reading(location, f"a recording ({reader})"):
        recording: Recording = module.open_frames(location, **({"dataset": inside} if inside else {}))
    if frame_rate is not None:
        recording.replace_rate(frame_rate)
    return recording
