"""Frame sources of a stream: files and folders of frames here, a module of its own for each kind of camera."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fingerflow.engines.engine import Array
from fingerflow.errors import FingerflowError, PlayerError, first_line
from fingerflow.player.logged_warnings import log
from fingerflow.player.named_objects import load_library
from fingerflow.player.sources.source import RecordedFrames, Source
from fingerflow.recordings.frames.open_recording import open_recording
from fingerflow.recordings.frames.recording import Recording

#: Kinds of files and folders, for messages.
KINDS = (
    "a recording (.cine, .mraw or .npy; .tif where tifffile is installed), a folder of pictures, a raw file or a video "
    "file"
)
_RECORDINGS = (".cih", ".cihx", ".cine", ".mraw", ".npy", ".tif", ".tiff")


def open_source(path: Path, shape: tuple[int, int] | None, dtype: str, first: int = 0) -> Source:
    """Open a file or folder as a source of frames, from number ``first`` on.

    ``shape`` and ``dtype`` are for raw files. Raises FingerflowError where there are no frames, or none that can be
    read.
    """
    suffix = path.suffix.lower()
    try:
        if not (path.is_dir() or path.is_file()):
            raise PlayerError(f"{path}: is no file; give {KINDS}, or `synthetic`")
        if path.is_dir() or suffix in _RECORDINGS:
            return _open_recorded(path, first)
        if suffix in (".raw", ".bin") or shape is not None:
            return RecordedFrames(iter(_raw(path, shape, dtype)[first:]))
        return _open_video(path, first)
    except FingerflowError:
        raise
    except ImportError as error:
        raise PlayerError(
            f"{path}: its format needs the library {error.name}: `pip install {error.name}`, or give frames as .npy"
        ) from None
    except Exception as error:  # libraries do not specify what they raise for a damaged file
        raise PlayerError(f"{path}: cannot be read as frames ({first_line(error)}); copy or save it again") from error


def _open_recorded(path: Path, first: int) -> Source:
    """Open a recording in one of those formats of `fingerflow.recordings` that need no video library."""
    recording = open_recording(path)
    for sentence in recording.warnings:
        log.warning("%s: %s", path, sentence)
    times = () if recording.times is None else recording.times[first:]
    return RecordedFrames(_recorded(recording, first), recording.close, times)


def _recorded(recording: Recording, first: int) -> Iterator[Array]:
    """Yield the frames of a recording from number `first` on.

    A damaged frame is black, so that it is not usable, and is logged. Raises FingerflowError for a frame of another
    size than the first.
    """
    for number in range(first, len(recording)):
        frame = recording[number]
        if damage := recording.unreadable.get(number):
            log.warning("%s: frame %d %s", recording.path, number, damage)
        yield frame


def _raw(path: Path, shape: tuple[int, int] | None, dtype: str) -> Array:
    """Return the memory map of the complete frames (N, H, W) in a raw file: pixels without a header, frame after
    frame.
    """
    if shape is None:
        raise PlayerError(f"{path}: a raw file needs --shape HEIGHT WIDTH and --dtype of its frames")
    pixels = np.memmap(path, np.dtype(dtype), "r")
    frames = pixels[: len(pixels) - len(pixels) % math.prod(shape)].reshape(-1, *shape)
    if not len(frames):
        raise PlayerError(
            f"{path}: its array is {frames.shape}; frames are (N, H, W) and at least one is needed: it has "
            f"{len(pixels)} pixels, fewer than a frame of {shape[0]} x {shape[1]}: correct it"
        )
    return frames


def _open_video(path: Path, first: int) -> Source:
    cv2 = load_library("cv2", "opencv-python-headless")
    capture = cv2.VideoCapture(str(path))
    if not capture.isOpened():
        raise PlayerError(f"{path}: OpenCV cannot open this video; give frames as .npy")
    for _ in range(first):
        capture.grab()
    return RecordedFrames(_video_frames(cv2, capture, path, first), capture.release)


def _video_frames(cv2: Any, capture: Any, path: Path, number: int) -> Iterator[Array]:
    """Yield the grey frames (H, W) from `number` on; log a message if the video has fewer frames than stated."""
    stated = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    while (read := capture.read())[0]:
        number += 1
        yield cv2.cvtColor(read[1], cv2.COLOR_BGR2GRAY) if read[1].ndim == 3 else read[1]
    if number < stated - 1:  # some containers state only a duration, from which OpenCV rounds the number of frames
        log.warning("%s: ends after %d of %d frames, as it is damaged or cut; copy it again", path, number, stated)
