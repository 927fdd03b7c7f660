"""TIFF stacks: one page a frame, ImageJ stacks, BigTIFF; mapped into memory where the pixels lie in one piece."""

from __future__ import annotations

import logging
import math
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from fingerflow.errors import FingerflowError
from fingerflow.recordings.frames.recording import Description, FileRecording, Frames, grey_dtype, missing_frames

GREY = (tifffile.PHOTOMETRIC.MINISBLACK, tifffile.PHOTOMETRIC.MINISWHITE)


def open_frames(path: Path, frame_rate: float | None) -> TiffRecording:
    """Read the pages' tags only. Raises FingerflowError for colour, two axes of frames and pages of different sizes.

    The rate is ImageJ's `finterval`, the seconds between two frames, where there is one; its `fps` is the speed of
    playback and does not count. The bit depth is the tag BitsPerSample.
    """
    complaints = _Complaints()
    logger = logging.getLogger("tifffile")
    logger.addFilter(complaints)
    try:
        file = tifffile.TiffFile(path)
        series = file.series
    except (tifffile.TiffFileError, ValueError, IndexError, OSError) as error:
        raise FingerflowError(f"{path}: cannot be read as TIFF, it is of another kind or damaged ({error})") from None
    finally:
        logger.removeFilter(complaints)
    try:
        description, stack = _describe(path, file, series, complaints.messages)
    except FingerflowError:
        file.close()
        raise
    return TiffRecording(description, frame_rate, file, stack)


class TiffRecording(FileRecording):
    """Frames from a memory map, or page by page where they are compressed or scattered."""

    def __init__(
        self, description: Description, frame_rate: float | None, file: tifffile.TiffFile, stack: _Stack
    ) -> None:
        super().__init__(description, frame_rate, stack if isinstance(stack, np.ndarray) else None)
        self._file = file
        self._stack = stack

    def _read_frame(self, index: int) -> Frames:
        return np.array(self._stack[index], self.dtype).reshape(self.frame_shape)

    def close(self) -> None:
        super().close()
        self._stack = []
        self._file.close()


class _Pages:
    """Pages behind an index, each decoded when it is asked for."""

    def __init__(self, pages: Any) -> None:
        self._pages = pages

    def __getitem__(self, index: int) -> Frames:
        image: Frames = self._pages[index].asarray()
        return image


_Stack = _Pages | np.ndarray[Any, Any] | list[Frames]


class _Complaints(logging.Filter):
    """Catches what tifffile says about a damaged file, which it opens all the same."""

    def __init__(self) -> None:
        super().__init__()
        self.messages: list[str] = []

    def filter(self, record: logging.LogRecord) -> bool:
        self.messages.append(record.getMessage())
        return False


def _describe(path: Path, file: tifffile.TiffFile, series: Any, complaints: list[str]) -> tuple[Description, _Stack]:
    if not series:
        raise FingerflowError(f"{path}: has no readable page; it ends after {path.stat().st_size} bytes")
    if len(series) > 1:
        shapes = ", ".join(f"{len(one.pages)} of {one.shape}" for one in series[:4])
        raise FingerflowError(f"{path}: its pages differ ({shapes}); all frames have one size and kind")
    stack, page = series[0], series[0].keyframe
    if page.photometric not in GREY or page.samplesperpixel != 1:
        kind = f"{getattr(page.photometric, 'name', page.photometric)}, {page.samplesperpixel} samples a pixel"
        raise FingerflowError(f"{path}: a colour file ({kind}); convert it to grey first")
    *leading, height, width = stack.shape
    if sum(length > 1 for length in leading) > 1 or stack.axes[-2:] != "YX" or page.imagedepth > 1:
        raise FingerflowError(f"{path}: its axes {stack.axes} are {stack.shape}; frames have one axis before YX")
    dtype = grey_dtype(np.dtype(stack.dtype), path)
    imagej = file.imagej_metadata or {}
    count = math.prod(leading)
    if count == 1 and stack.dataoffset is not None:
        # ImageJ keeps the pixels in one piece and the list of pages behind them; cut off there, the count survives.
        count = max(count, int(imagej.get("images", 1)))
    size = path.stat().st_size
    frames: _Stack
    if stack.dataoffset is not None:
        whole = min(count, (size - stack.dataoffset) // (height * width * dtype.itemsize))
        shape = (max(whole, 0), height, width)
        frames = np.memmap(path, dtype.newbyteorder(file.byteorder), "r", stack.dataoffset, shape) if whole > 0 else []
    else:
        whole = sum(_is_whole(one, size) for one in stack.pages)
        frames = _Pages(stack.pages)
    if whole <= 0:
        raise FingerflowError(f"{path}: not one of its {count} frames is there whole; copy the file again")
    warnings = []
    if "C" in stack.axes and stack.shape[stack.axes.index("C")] > 1:
        warnings.append(f"the file calls its {count} images channels; they are read as frames")
    if whole < count:
        warnings.append(missing_frames(count - whole, count))
    elif complaints:
        warnings.append(f"truncated or damaged: frames after the last of {whole} may be missing ({complaints[0]})")
    if page.photometric == tifffile.PHOTOMETRIC.MINISWHITE:
        warnings.append("the file declares 0 as white: grey values are kept as stored, so larger ones are darker")
    return (
        Description(
            path=path,
            count=whole,
            frame_shape=(height, width),
            dtype=dtype,
            bit_depth=None if dtype.kind == "f" else page.bitspersample,
            frame_rate=_rate(imagej),
            warnings=tuple(warnings),
            metadata={"axes": stack.axes, **{key: imagej[key] for key in ("finterval", "unit") if key in imagej}},
        ),
        frames,
    )


def _is_whole(page: Any, size: int) -> bool:
    pieces = zip(page.dataoffsets, page.databytecounts, strict=False)
    return all(offset + length <= size for offset, length in pieces)


def _rate(imagej: dict[str, Any]) -> float | None:
    interval = imagej.get("finterval")
    if not isinstance(interval, (int, float)) or not interval > 0:
        return None
    seconds = {"ms": 1e-3, "msec": 1e-3, "us": 1e-6, "\\u00B5s": 1e-6, "µs": 1e-6, "min": 60.0}
    return 1.0 / (interval * seconds.get(str(imagej.get("tunit", "sec")), 1.0))
