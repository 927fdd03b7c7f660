"""Common interface of recordings in all file formats: frames read on demand, and the time of each frame."""

from __future__ import annotations

import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError, first_line
from fingerflow.schema.pixel_types import COMPUTED_TYPES

# Lossy codecs (names in FFmpeg and tifffile) that compress each frame independently of the others (intra-frame).
EACH_FRAME_BY_ITSELF = frozenset(
    ("mjpeg", "jpeg", "ojpeg", "jpeg_lossy", "alt_jpeg", "webp", "jpeg2000", "dvvideo", "prores", "dnxhd", "cfhd")
)

_PLAYBACK_HZ = 60.0  # Hz, highest stated rate that may be that of playback instead of recording
_SAME_RATE = 0.01

Frames = NDArray[Any]


@dataclass(frozen=True)
class Description:
    """Metadata from the header of a recording, taken by a reader before any frame is read; see `Recording`.

    `count`: complete frames in the file; `stated_count`: frames that it should have, if these are more. `bit_depth`:
    None if the file states none. `first_number`: number of the first frame, counted from the trigger, or 0 if the file
    states no trigger. `time_stamps`: s for each frame, 0 at the trigger; None for evenly spaced frames. `unreadable`:
    frames known to be damaged, by number, and the reason. `orientation`: as the file states it, "1" for none.
    """

    path: Path
    count: int
    frame_shape: tuple[int, int]
    dtype: np.dtype[Any]
    bit_depth: int | None = None
    stated_count: int = 0
    frame_rate: float | None = None
    first_number: float = 0.0
    time_stamps: NDArray[np.float64] | None = None
    warnings: tuple[str, ...] = ()
    metadata: dict[str, Any] = field(default_factory=dict)
    has_trigger: bool = False
    lossy: str | None = None
    unreadable: Mapping[int, str] = field(default_factory=dict)
    orientation: str = "1"


class DamagedFrame(FingerflowError):
    """Error for a single frame that cannot be read; the message is the reason, as in `Recording.unreadable`."""


class Recording(ABC):
    """Sequence of grey frames that are read from a file on demand.

    `recording[3]` is an array (H, W); `recording[10:0:-2]` and `recording[[3, 1, 2]]` are recordings that are read on
    demand too; `read()` returns all frames as (N, H, W) and `batches(n)` yields n at a time.

    Attributes: `path`; `frame_shape` (H, W); `dtype` (unsigned integer or float); `bit_depth` (integer grey values lie
    in 0 .. 2**bit_depth - 1: the true depth if the file states it, else that of the data type, never guessed from the
    values; None for float); `frame_rate` in Hz, None if unknown; `times`, float64, s, one a frame, 0 at the trigger if
    the file has one, else at the first frame, None without a rate; `warnings`, sentences for the user; `metadata`,
    other entries of the file (camera, exposure, levels); `has_trigger`, whether the file states the trigger frame;
    `lossy`, the codec if it is lossy ("h264", "jpeg"), else None.
    """

    times: NDArray[np.float64] | None

    def __init__(self, header: Description | Recording) -> None:
        self.path: Path = header.path
        self.frame_shape: tuple[int, int] = header.frame_shape
        self.dtype: np.dtype[Any] = header.dtype
        self.bit_depth: int | None = header.bit_depth
        self.frame_rate: float | None = header.frame_rate
        self.warnings: tuple[str, ...] = header.warnings
        self.metadata: dict[str, Any] = header.metadata
        self.has_trigger: bool = header.has_trigger
        self.lossy: str | None = header.lossy

    @property
    def takes_from_other_frames(self) -> str | None:
        """Return the name of the recording's codec if it predicts frames from other frames, else None.

        Standard deviations are invalid in such a recording.
        """
        return None if self.lossy is None or self.lossy in EACH_FRAME_BY_ITSELF else self.lossy

    @property
    @abstractmethod
    def unreadable(self) -> Mapping[int, str]:
        """Return, by frame index, the reason why a damaged frame cannot be read; the text continues the words "frame
        12".

        Such a frame is read as NaN, or as 0 for integer pixels; no result may be computed from it. Damage that no
        header states (videos, compressed pages) is known only after the frame was read, so check this again after
        reading.
        """

    @property
    @abstractmethod
    def doubtful(self) -> Mapping[int, str]:
        """Return, by frame index, the decoder's error message for each frame that may be decoded wrongly.

        Some are right, and some hold wrong pixels. Known after the frame was read, as `unreadable` is.
        """

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of complete frames."""

    @abstractmethod
    def _read_frame(self, index: int) -> Frames:
        """Return frame `index` as (H, W); if the frame is unreadable, all pixels are NaN, or 0 for integers."""

    @abstractmethod
    def close(self) -> None:
        """Close the recorded file. Reading afterwards is an error."""

    @overload
    def __getitem__(self, key: int) -> Frames: ...

    @overload
    def __getitem__(self, key: slice | Sequence[int] | NDArray[np.integer[Any]]) -> Recording: ...

    def __getitem__(self, key: int | slice | Sequence[int] | NDArray[np.integer[Any]]) -> Frames | Recording:
        if isinstance(key, slice):
            return self._view(range(len(self))[key])
        if isinstance(key, (list, tuple, range)) or (isinstance(key, np.ndarray) and key.ndim == 1):
            if isinstance(key, np.ndarray) and key.dtype.kind not in "iu":
                raise TypeError(f"frames are chosen by whole numbers, not by {key.dtype}; try np.flatnonzero(mask)")
            return self._view([self._within(operator.index(number)) for number in key])
        return self._read_frame(self._within(operator.index(key)))  # type: ignore[arg-type]

    def __iter__(self) -> Iterator[Frames]:
        for index in range(len(self)):
            yield self._read_frame(index)

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        height, width = self.frame_shape
        rate = "rate unknown" if self.frame_rate is None else f"{self.frame_rate:g} Hz"
        depth = "" if self.bit_depth is None else f", {self.bit_depth} bit"
        return f"<Recording {self.path.name}: {len(self)} frames of {height} x {width}, {self.dtype}{depth}, {rate}>"

    def read(self) -> Frames:
        """Return all frames as one array (N, H, W). Take a slice first if they do not fit into memory."""
        frames = np.empty((len(self), *self.frame_shape), self.dtype)
        for index in range(len(self)):
            frames[index] = self._read_frame(index)
        return frames

    def mapped(self) -> Frames:
        """Return all frames as one read-only array (N, H, W), as a memory map where the file format allows it.

        It is the file's memory map, without a copy, if the stored pixels need no decoding; else the frames are read.
        """
        frames = self._memory_map()
        return self.read() if frames is None else frames

    def _memory_map(self) -> Frames | None:
        """Return the memory map (N, H, W) of all frames; None if frames must be decoded."""
        return None

    def _view(self, indices: Sequence[int]) -> Recording:
        return _View(self, indices)

    def _within(self, index: int) -> int:
        count = len(self)
        if not -count <= index < count:
            raise IndexError(f"{self.path.name} has {count} frames: frame {index} is not among them")
        return index % count


class FileRecording(Recording):
    """Recording of all frames in a file, each read from a memory map or by a function of the reader of its format.

    `frames` is a memory map (N, H, W), or a function that reads frame `index` as a new array (H, W), or raises why it
    cannot. `close_file` closes the file.

    Attributes:
        kept_bytes: size of the decoded frames, the first ones that are read, that stay in memory for a caller that
            needs them again and does not change them; 0 by default.
    """

    def __init__(
        self,
        description: Description,
        frames: Frames | Callable[[int], Frames] | None,
        close_file: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(description)
        self.dtype = description.dtype.newbyteorder("=")
        if self.dtype.kind == "f":
            self.bit_depth = None
        elif self.bit_depth is None:
            # The depth of the type, since a guess from the values would depend on them.
            self.bit_depth = 8 * self.dtype.itemsize
        missing = description.stated_count - description.count
        if missing > 0:
            cut = f"truncated: {missing} of {description.stated_count} frames are missing at the end of the file"
            self.warnings = (cut, *self.warnings)
        if description.orientation != "1":
            self.warnings += (
                f"the file states an orientation or wide pixels ({description.orientation}), by which viewers turn or "
                "stretch the picture; frames are read as stored: check that views and calibration are of them",
            )
        if description.lossy is not None:
            self.warnings += (lossy_codec(description.lossy),)
        self._unreadable = dict(description.unreadable)
        self._doubtful: dict[int, str] = {}
        self._kept: dict[int, Frames] = {}  # decoded frames by number, as far as they fit in `kept_bytes`
        self.kept_bytes = 0
        self._count, self._first_number = description.count, description.first_number
        self._frames, self._close_file = frames, close_file
        self.times = description.time_stamps
        if self.frame_rate is not None and not possible_rate(self.frame_rate):
            self.warnings += (
                f"the file states a frame rate of {self.frame_rate:g} Hz, which cannot be; the recording has none",
            )
            self.frame_rate = self.times = None
        if self.times is None and self.frame_rate is not None:
            self.replace_rate(self.frame_rate)

    def replace_rate(self, frame_rate: float) -> None:
        """Replace the frame rate (Hz) of the recording by a given one, and the frame times by those that follow from
        it.

        Time 0 stays at the trigger. A warning tells of a rate that the file contradicts; a video may state that of its
        playback.
        """
        stated = self.frame_rate
        if stated is not None and stated > _PLAYBACK_HZ and abs(frame_rate / stated - 1) > _SAME_RATE:
            self.warnings += (
                f"the file states {stated:g} Hz, and frame_rate = {frame_rate:g} is taken: all times and "
                "rates follow from it. Leave it out unless the file is wrong",
            )
        self.frame_rate = frame_rate
        self.times = np.asarray((self._first_number + np.arange(self._count)) / frame_rate)

    def __len__(self) -> int:
        return self._count

    @property
    def unreadable(self) -> Mapping[int, str]:
        return MappingProxyType(self._unreadable)

    @property
    def doubtful(self) -> Mapping[int, str]:
        return MappingProxyType(self._doubtful)

    def _decode(self, index: int) -> Frames:
        """Return the pixels (H, W) of frame `index`; raise DamagedFrame if they cannot be decoded."""
        if self._frames is None:
            raise FingerflowError(f"{self.path}: the file is closed; open it again")
        if isinstance(self._frames, np.ndarray):
            return np.array(self._frames[index], self.dtype)
        try:
            return np.asarray(self._frames(index), self.dtype)
        except FingerflowError:
            raise
        except Exception as error:  # codecs and filters may raise any exception for a damaged frame
            raise DamagedFrame(f"cannot be decoded ({first_line(error)})") from error

    def _read_frame(self, index: int) -> Frames:
        if index not in self._unreadable:
            if index in self._kept:
                return self._kept[index]
            try:
                frame = self._decode(index)
            except DamagedFrame as error:
                self._unreadable[index] = str(error)
            else:
                if (len(self._kept) + 1) * frame.nbytes <= self.kept_bytes and not isinstance(self._frames, np.ndarray):
                    self._kept[index] = frame
                return frame
        return np.full(self.frame_shape, np.nan if self.dtype.kind == "f" else 0, self.dtype)

    def _memory_map(self) -> Frames | None:
        # A memory map can be used without a copy only if contiguous and in native byte order.
        frames = self._frames
        usable = isinstance(frames, np.ndarray) and frames.dtype == self.dtype and frames.flags.c_contiguous
        return np.asarray(frames) if usable else None

    def close(self) -> None:
        self._frames = None
        self._kept.clear()
        self._close_file()


class _View(Recording):
    """Recording that consists of selected frames of another recording, in any order."""

    def __init__(self, file: Recording, indices: Sequence[int]) -> None:
        super().__init__(file)
        self._file = file
        self._indices = indices
        self.times = None if file.times is None else file.times[np.asarray(indices, dtype=np.intp)]
        if self.frame_rate is not None and len(indices) > 1:  # 150 Hz for every second frame of 300 Hz
            step, *irregular = {abs(difference) for difference in _steps(indices)}
            self.frame_rate = self.frame_rate / step if step > 0 and not irregular else None

    def __len__(self) -> int:
        return len(self._indices)

    @property
    def unreadable(self) -> Mapping[int, str]:
        return self._select_frames(self._file.unreadable)

    @property
    def doubtful(self) -> Mapping[int, str]:
        return self._select_frames(self._file.doubtful)

    def _select_frames(self, entries: Mapping[int, str]) -> dict[int, str]:
        selected = enumerate(self._indices if entries else ())
        return {position: entries[index] for position, index in selected if index in entries}

    def _read_frame(self, index: int) -> Frames:
        return self._file._read_frame(self._indices[index])

    def _memory_map(self) -> Frames | None:
        stack, indices = self._file._memory_map(), self._indices
        if stack is None or not len(indices):
            return None
        step, *irregular = _steps(indices) or {1}
        # Tensors cannot have negative strides.
        return stack[indices[0] : indices[-1] + 1 : step] if step > 0 and not irregular else None

    def _view(self, indices: Sequence[int]) -> Recording:
        # A view of a view refers to the file directly, so that a chain of slices is as fast as a single slice.
        return _View(self._file, [self._indices[index] for index in indices])

    def close(self) -> None:
        self._file.close()


def _steps(indices: Sequence[int]) -> set[int]:
    """Return the set of differences between successive indices."""
    return {after - before for before, after in pairwise(indices)}


def possible_rate(rate: float) -> bool:
    """Return whether a frame rate in Hz is possible: finite, positive, and with distinct frame times."""
    return 1e-6 < rate < 1e9  # limits of `recording.frame_rate` in scenes


def grey_dtype(dtype: np.dtype[Any], path: Path) -> np.dtype[Any]:
    """Return a data type unchanged, after checking that it can hold grey values.

    Raises FingerflowError for types that the kernels do not take, among them signed integers, logical and complex
    values, for which the meaning of zero is ambiguous.
    """
    if dtype.name in COMPUTED_TYPES:
        return dtype
    raise FingerflowError(
        f"{path}: pixels are {dtype}, but frames are {', '.join(COMPUTED_TYPES)}. Save them as uint8, uint16 or float32"
    )


def surplus(left: int, frame_bytes: int, count: int) -> tuple[str, ...]:
    """Return a warning, in a tuple, if `left` bytes after the last of `count` frames could hold further frames; else
    ().
    """
    more = left // frame_bytes
    message = f"the header states {count} frames, and the file holds {more} more behind them, which are not read"
    return (f"{message}: copy it again, or correct the header",) if more > 0 else ()


def lossy_codec(name: str) -> str:
    """Return a warning for the user that the lossy codec `name` has altered the pixels.

    A codec that compresses each frame by itself leaves an error that differs from frame to frame. Residuals include it,
    and deviations from them are valid: on the shipped press as Motion JPEG two of three errors lie within the stated
    deviation. A codec that predicts frames from others keeps skin in place until it has moved enough. That error
    persists and neighbours share it; neither the residual of a window nor the scatter of points or of frames contains
    more than a part of it (`tests/recordings/test_lossy_deviations.py`).
    """
    remedy = "record without compression, or with a lossless codec such as FFV1"
    if name in EACH_FRAME_BY_ITSELF:
        return (
            f"{name} is a lossy codec, which changes fine texture: points are found less exactly than in the camera's "
            f"pictures, as the stated deviations say; {remedy}"
        )
    return (
        f"{name} is a lossy codec, which takes frames from each other: skin lags behind by an error that no residual "
        "shows. The deviation of positions is stated 2 to 10 times too small (H.264: 0.09 to 0.3 px off where 0.03 to "
        f"0.05 is stated), and those of displacement and of all that follows from it are NaN; {remedy}"
    )
