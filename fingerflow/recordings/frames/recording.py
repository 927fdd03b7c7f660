"""Recording of any file format: frames read on demand, and the time of each frame."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
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


class FrameFile:
    """Open file with frames, each read from a memory map or by a function of the reader of its format.

    Attributes:
        unreadable, doubtful: as those of `Recording`, by number of the frame in the file.
        kept_bytes: size of the decoded frames, the first ones that are read, that stay in memory for a caller that
            needs them again and does not change them; 0 by default.
    """

    def __init__(
        self, description: Description, frames: Frames | Callable[[int], Frames] | None,
        close_file: Callable[[], None] = lambda: None,
    ) -> None:  # fmt: skip
        """`frames` is a memory map (N, H, W), or a function that reads frame `index` as a new array (H, W), or raises
        why it cannot. `close_file` closes the file.
        """
        self.path, self.frame_shape = description.path, description.frame_shape
        self.dtype = description.dtype.newbyteorder("=")
        self.unreadable = dict(description.unreadable)
        self.doubtful: dict[int, str] = {}
        self.kept_bytes = 0
        self._kept: dict[int, Frames] = {}  # decoded frames by number, as far as they fit in `kept_bytes`
        self._frames, self._close_file = frames, close_file

    def read(self, index: int) -> Frames:
        """Return frame `index` as (H, W); if the frame is unreadable, all pixels are NaN, or 0 for integers."""
        if index not in self.unreadable:
            if index in self._kept:
                return self._kept[index]
            try:
                frame = self.decode(index)
            except DamagedFrame as error:
                self.unreadable[index] = str(error)
            else:
                if (len(self._kept) + 1) * frame.nbytes <= self.kept_bytes and not isinstance(self._frames, np.ndarray):
                    self._kept[index] = frame
                return frame
        return np.full(self.frame_shape, np.nan if self.dtype.kind == "f" else 0, self.dtype)

    def decode(self, index: int) -> Frames:
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

    def memory_map(self) -> Frames | None:
        """Return the memory map (N, H, W) of all frames; None if frames must be decoded.

        It can be used without a copy only if contiguous and in native byte order.
        """
        frames = self._frames
        usable = isinstance(frames, np.ndarray) and frames.dtype == self.dtype and frames.flags.c_contiguous
        return np.asarray(frames) if usable else None

    def close(self) -> None:
        self._frames = None
        self._kept.clear()
        self._close_file()


class Recording:
    """Sequence of grey frames that are read from a file on demand.

    `recording[3]` is an array (H, W); `recording[10:0:-2]` and `recording[[3, 1, 2]]` are recordings that are read on
    demand too; `read()` returns all frames as (N, H, W).

    Attributes: `path`; `file`, which all recordings of its frames share; `frame_shape` (H, W); `dtype` (unsigned
    integer or float); `bit_depth` (integer grey values lie in 0 .. 2**bit_depth - 1: the true depth if the file states
    it, else that of the data type, never guessed from the values; None for float); `frame_rate` in Hz, None if unknown;
    `times`, float64, s, one a frame, 0 at the trigger if the file has one, else at the first frame, None without a
    rate; `warnings`, sentences for the user; `metadata`, other entries of the file (camera, exposure, levels);
    `has_trigger`, whether the file states the trigger frame; `lossy`, the codec if it is lossy ("h264", "jpeg"), else
    None.
    """

    def __init__(self, description: Description, file: FrameFile) -> None:
        self.file = file
        self._indices: Sequence[int] = range(description.count)
        self.path, self.frame_shape, self.dtype = file.path, file.frame_shape, file.dtype
        self.metadata, self.has_trigger, self.lossy = description.metadata, description.has_trigger, description.lossy
        # The depth of the type, if none is stated, since a guess from the values would depend on them.
        self.bit_depth = None if self.dtype.kind == "f" else description.bit_depth or 8 * self.dtype.itemsize
        self.warnings: tuple[str, ...] = description.warnings
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
        self.frame_rate, self.times = description.frame_rate, description.time_stamps
        self._first_number = description.first_number
        if self.frame_rate is not None and not possible_rate(self.frame_rate):
            self.warnings += (
                f"the file states a frame rate of {self.frame_rate:g} Hz, which cannot be; the recording has none",
            )
            self.frame_rate = self.times = None
        if self.times is None and self.frame_rate is not None:
            self.replace_rate(self.frame_rate)
        self._rate_of_file = self.frame_rate

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
        self.frame_rate = self._rate_of_file = frame_rate
        self.times = np.asarray((self._first_number + np.arange(len(self))) / frame_rate)

    @property
    def takes_from_other_frames(self) -> str | None:
        """Return the name of the recording's codec if it predicts frames from other frames, else None.

        Standard deviations are invalid in such a recording.
        """
        return None if self.lossy is None or self.lossy in EACH_FRAME_BY_ITSELF else self.lossy

    @property
    def unreadable(self) -> Mapping[int, str]:
        """Return, by frame index, the reason why a damaged frame cannot be read; the text continues the words "frame
        12".

        Such a frame is read as NaN, or as 0 for integer pixels; no result may be computed from it. Damage that no
        header states (videos, compressed pages) is known only after the frame was read, so check this again after
        reading.
        """
        return self._of_frames(self.file.unreadable)

    @property
    def doubtful(self) -> Mapping[int, str]:
        """Return, by frame index, the decoder's error message for each frame that may be decoded wrongly.

        Some are right, and some hold wrong pixels. Known after the frame was read, as `unreadable` is.
        """
        return self._of_frames(self.file.doubtful)

    def _of_frames(self, entries: Mapping[int, str]) -> dict[int, str]:
        selected = enumerate(self._indices if entries else ())
        return {position: entries[index] for position, index in selected if index in entries}

    def __len__(self) -> int:
        """Return the number of complete frames."""
        return len(self._indices)

    @overload
    def __getitem__(self, key: int) -> Frames: ...

    @overload
    def __getitem__(self, key: slice | Sequence[int] | NDArray[np.integer[Any]]) -> Recording: ...

    def __getitem__(self, key: int | slice | Sequence[int] | NDArray[np.integer[Any]]) -> Frames | Recording:
        if isinstance(key, slice):
            return self._select(key, self._indices[key])
        if isinstance(key, (list, tuple, range)) or (isinstance(key, np.ndarray) and key.ndim == 1):
            if isinstance(key, np.ndarray) and key.dtype.kind not in "iu":
                raise TypeError(f"frames are chosen by whole numbers, not by {key.dtype}; try np.flatnonzero(mask)")
            positions = [self._within(operator.index(number)) for number in key]
            return self._select(positions, [self._indices[position] for position in positions])
        # The checker does not know that anything else than a whole number ends in a TypeError here.
        return self.file.read(self._indices[self._within(operator.index(key))])  # type: ignore[arg-type]

    def _select(self, positions: slice | list[int], indices: Sequence[int]) -> Recording:
        """Return the recording of the frames at the given positions in this one, with these indices in the file."""
        selected = copy(self)
        selected._indices = indices
        if self.times is not None:
            selected.times = self.times[positions] if len(indices) else self.times[:0]
        if self._rate_of_file is not None and len(indices) > 1:  # 150 Hz for every second frame of 300 Hz
            step, *irregular = {abs(difference) for difference in _steps(indices)}
            selected.frame_rate = self._rate_of_file / step if step > 0 and not irregular else None
        return selected

    def _within(self, index: int) -> int:
        count = len(self)
        if not -count <= index < count:
            raise IndexError(f"{self.path.name} has {count} frames: frame {index} is not among them")
        return index % count

    def __iter__(self) -> Iterator[Frames]:
        return map(self.file.read, self._indices)

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the recorded file. Reading afterwards is an error."""
        self.file.close()

    def __repr__(self) -> str:
        height, width = self.frame_shape
        rate = "rate unknown" if self.frame_rate is None else f"{self.frame_rate:g} Hz"
        depth = "" if self.bit_depth is None else f", {self.bit_depth} bit"
        return f"<Recording {self.path.name}: {len(self)} frames of {height} x {width}, {self.dtype}{depth}, {rate}>"

    def read(self) -> Frames:
        """Return all frames as one array (N, H, W). Take a slice first if they do not fit into memory."""
        frames = np.empty((len(self), *self.frame_shape), self.dtype)
        for position, frame in enumerate(self):
            frames[position] = frame
        return frames

    def mapped(self) -> Frames:
        """Return all frames as one read-only array (N, H, W), as a memory map where the file format allows it.

        It is the file's memory map, without a copy, if the stored pixels need no decoding; else the frames are read.
        """
        stack, indices = self.file.memory_map(), self._indices
        step, *irregular = _steps(indices) or {1}
        if stack is None or not len(indices) or step < 1 or irregular:  # tensors cannot have negative strides
            return self.read()
        return stack[indices[0] : indices[-1] + 1 : step]


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
