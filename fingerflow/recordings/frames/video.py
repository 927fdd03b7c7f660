"""Reader of video files (AVI, MP4, MKV, MOV), decoded by FFmpeg (PyAV), with exact access to any frame.

Grey is kept as stored, with more than 8 bits too. Of a YUV video the luma plane is taken as stored, without stretching
its range. RGB is accepted if the three channels are equal, as many programs save grey without loss; a frame in colour
is refused when it is read.
"""

from __future__ import annotations

import threading
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError, first_line
from fingerflow.recordings.frames.ffv1_checksum import slices_are_whole
from fingerflow.recordings.frames.recording import DamagedFrame, Description, FrameFile, Frames, Recording
from fingerflow.recordings.guard.child_process import check_in_child_process
from fingerflow.recordings.guard.claimed_sizes import MOST_PIXELS
from fingerflow.recordings.guard.file_checks import reading

CACHE_BYTES = 128 * 2**20
PACKED_LUMA = {"yuyv422": slice(0, None, 2), "yvyu422": slice(0, None, 2), "uyvy422": slice(1, None, 2)}
LUMA_RANGE = {1: "limited", 2: "full"}
_REPORTS = threading.Lock()  # FFmpeg has a single log for all decoders
# Without these flags a decoder fills damaged parts with old pixels.
CHECKS = {"err_detect": "crccheck+bitstream+buffer+explode"}

# PyAV 19 takes names and titles in any encoding, and no such argument.
_LENIENT: dict[str, Any] = {"metadata_errors": "replace"} if int(av.__version__.partition(".")[0]) < 19 else {}


def open_frames(path: Path) -> Recording:
    """Open a video and index all frames without decoding; raise FingerflowError if FFmpeg cannot read the file.

    Formats with a full index (AVI, MP4, MOV without reordered frames) state it; of the others all packets are read.
    """
    check_in_child_process(path, "video")
    with _open(path) as container, reading(path, "video"):
        if not container.streams.video:
            raise FingerflowError(f"{path}: has no video stream; name a video, or record it again")
        stream = container.streams.video[0]
        if stream.codec_context is None:
            raise FingerflowError(f"{path}: its codec is not known; convert it, for example to FFV1 in .mkv")
        pixels = _pixels(path, stream.codec_context.pix_fmt, stream.codec_context.height, stream.codec_context.width)
        rate, tick, file_format = stream.average_rate, stream.time_base, container.format.name
        # An edit list leaves out frames of an MP4 that the number in its header counts.
        entries = [entry for entry in stream.index_entries if not entry.is_discard]
        promised = len(entries) if "mp4" in file_format else stream.frames
        luma_range = LUMA_RANGE.get(int(stream.codec_context.color_range), "not stated")
        codec, lossy = stream.codec_context.name, _lossy(stream.codec_context)
        seconds = (container.duration or 0) / av.time_base
        index = _index(path, container, stream, entries)
    if not index.count:
        raise FingerflowError(f"{path}: not one frame can be read; the file ends too early or is damaged")
    warnings = []
    # MKV states no number of frames, only the duration, AVI the number of ticks, dropped frames among them: what is
    # missing at the end lies behind the last time stamp.
    in_ticks = "avi" in file_format
    missing = promised - index.count if promised else 0
    if rate and (in_ticks or not promised):
        step = 1 / float(rate * tick)
        ticks = step * np.arange(index.count) if index.stamps is None else index.stamps.astype(np.float64)
        if index.count > 1:
            step = max(step, float(np.median(np.diff(ticks))))
        behind = (promised if in_ticks else seconds / float(tick)) - (ticks[-1] - min(ticks[0], 0.0)) - step
        missing = round(behind / step) if behind > 0.5 * step + 1 else 0
    if missing <= 0 and not promised and (cut := unfinished(path)):
        warnings.append(f"truncated: {cut}; frames may be missing at the end")
    if pixels.is_luma:
        meaning = f"its brightness (luma) is used as stored, range {luma_range}; its colour is dropped"
        warnings.append(f"a colour video ({pixels.name}): {meaning}")
    interlaced, orientation = _first_picture(path)
    if interlaced:
        meaning = (
            "odd and even rows of a frame are half a frame apart, so moving skin is torn; record progressive frames"
        )
        warnings.append(f"the video is interlaced: {meaning}")
    hertz = float(rate) if rate else None
    stamps = None if index.stamps is None else (index.stamps - index.stamps[0]) * float(tick)
    if hertz is not None and stamps is not None:
        # Containers round time stamps to a tick (MKV: 1 ms), so stamps that are evenly spaced within a tick count as
        # even; the rate that they state may be that of their ticks or of the playback.
        rates = hertz, (index.count - 1) / max(float(stamps[-1]), float(tick))
        for hertz in rates:
            if np.max(np.abs(stamps - np.arange(index.count) / hertz)) <= float(tick) * 1.001:
                stamps = None
                break
        else:
            warnings.append(f"frames are not evenly spaced; {hertz:g} Hz is their average rate")
    description = Description(
        path=path,
        count=index.count,
        stated_count=index.count + missing,
        frame_shape=pixels.shape,
        dtype=pixels.dtype,
        bit_depth=pixels.bits,
        frame_rate=hertz,
        time_stamps=stamps if hertz is not None else None,
        warnings=tuple(warnings),
        lossy=lossy,
        unreadable=index.damaged,
        orientation=orientation,
        metadata={"codec": codec, "pixel_format": pixels.name, "luma_range": luma_range},
    )
    return Recording(description, VideoFile(description, pixels, index))


class VideoFile(FrameFile):
    """Open video file, decoded from the key frame before a requested frame, with a cache of decoded frames.

    Reading backwards decodes each group of pictures once if it fits into `CACHE_BYTES`.
    """

    def __init__(self, description: Description, pixels: _Pixels, index: _Index) -> None:
        super().__init__(description, self._picture, self._end_decoding)
        self._pixels, self._index = pixels, index
        self._container: Any = None
        self._decoded: Iterator[tuple[int, Any]] = iter(())
        self._has_checksums = False
        if description.metadata["codec"] == "ffv1":  # judged by the first five packets
            with _open(self.path) as container, reading(self.path, "video"):
                packets = islice(container.demux(video=0), 5)
                self._has_checksums = any(slices_are_whole(bytes(packet)) for packet in packets)
        self._next = -1  # index of the frame that the decoder gives next; -1 if it is not open
        self._cache: OrderedDict[int, Frames] = OrderedDict()
        self._cached_at_most = max(2, CACHE_BYTES // (self.frame_shape[0] * self.frame_shape[1] * self.dtype.itemsize))

    def _picture(self, index: int) -> Frames:
        if index not in self._cache:
            self._decode_to(index)
        if index in self.unreadable:
            raise DamagedFrame(self.unreadable[index])
        return self._cache[index].copy()

    def _decode_to(self, target: int) -> None:
        nearest = self._index.keys[bisect_right(self._index.keys, target) - 1]
        if not nearest <= self._next <= target:
            self._restart(nearest)
        if self._run_to(target):
            return
        self._restart(0)  # decode from the start, if seeking misses the key frame
        if not self._run_to(target):
            self._mark_damaged(target, "gives no picture")

    def _run_to(self, target: int) -> bool:
        for number, frame in self._decoded:
            if number > target:
                return False
            self._next = number + 1
            if frame.is_corrupt:
                self._mark_damaged(number, "is marked as corrupt by the decoder")
            if not self._pixels.fit(frame):
                self._mark_damaged(
                    number, f"is {frame.height} x {frame.width} {frame.format.name}, not as the header says"
                )
            if number not in self.unreadable:
                self._cache[number] = self._pixels.convert(frame, self.path, number)
            while len(self._cache) > self._cached_at_most:
                self._cache.popitem(last=False)
            if number == target:
                return True
        return False

    def _mark_damaged(self, number: int, reason: str) -> None:
        """Mark a frame as unreadable, and with it all frames that may be decoded from this frame."""
        self.unreadable.setdefault(number, reason)
        for dependent in self._dependent_frames(number):
            self.unreadable.setdefault(dependent, f"is made from frame {number}, which {reason}")
            self._cache.pop(dependent, None)

    def _dependent_frames(self, number: int) -> range:
        """Return the range of frames that an error in frame `number` may spoil: those that the decoder has not
        delivered yet, up to the next key frame.

        Those shown before it are among them, since bidirectional frames are decoded after the one behind them.
        """
        keys = self._index.keys
        position = bisect_right(keys, number)
        return range(min(self._next, number + 1), keys[position] if position < len(keys) else self._index.count)

    def _restart(self, key: int) -> None:
        if self._container is None or key == 0:
            self._end_decoding()
            self._container = _open(self.path)
        stream = self._container.streams.video[0]
        stream.codec_context.options = CHECKS
        if key > 0 and self._index.stamps is not None:
            self._container.seek(int(self._index.stamps[key]), stream=stream)
        self._next = key
        self._decoded = self._numbered(stream, key)

    def _numbered(self, stream: Any, key: int) -> Iterator[tuple[int, Any]]:
        """Yield frame number and image of each frame that is decoded from key frame `key` on, except frames displayed
        before it.
        """
        count = 0
        packets = self._container.demux(stream)
        while True:
            number = None
            try:
                with _reported_errors() as errors:
                    packet = next(packets, None)
                    if packet is None:
                        return
                    number = self._index.numbers.get(packet.pts)
                    if self._has_checksums and number is not None and not slices_are_whole(bytes(packet)):
                        self._mark_damaged(number, "has a wrong checksum")
                    frames = packet.decode()
                if errors and number is not None and number >= key:
                    for affected in (number, *self._dependent_frames(number)):
                        self.doubtful.setdefault(affected, errors[0])
            except (av.FFmpegError, ValueError, MemoryError) as error:
                if self._index.stamps is None:
                    raise FingerflowError(
                        f"{self.path}: frame {count} cannot be decoded ({first_line(error)}), and without time stamps "
                        "those behind it have no number; copy the file again"
                    ) from error
                if number is None:  # the error is not that of one packet, so the rest of the file cannot be read
                    return
                if number >= key:
                    self._mark_damaged(number, f"cannot be decoded ({first_line(error)})")
                continue
            for frame in frames:
                of_frame = self._index.numbers.get(frame.pts) if self._index.stamps is not None else count
                count += 1
                if of_frame is not None and of_frame >= key:
                    yield of_frame, frame

    def close(self) -> None:
        super().close()
        self._cache.clear()

    def _end_decoding(self) -> None:
        if self._container is not None:
            self._container.close()
        self._container, self._decoded, self._next = None, iter(()), -1


@dataclass(frozen=True)
class _Index:
    """Index of a video: times of all frames, and the key frames at which decoding can start.

    `stamps`: ticks in display order, None if the file has no usable ones (then decoding always starts at the
    beginning). `keys`: numbers of the frames at which decoding can start, in order. `numbers`: frame numbers by stamp.
    `damaged`: frames that the container marks as damaged, and why.
    """

    count: int
    stamps: NDArray[np.int64] | None
    keys: list[int]
    numbers: dict[int, int]
    damaged: dict[int, str]


@dataclass(frozen=True)
class _Pixels:
    """Pixel format of a video, which determines how decoded images are converted to grey values."""

    name: str
    shape: tuple[int, int]
    dtype: np.dtype[Any]
    bits: int
    shift: int
    stored: np.dtype[Any]
    is_rgb: bool
    is_luma: bool

    def fit(self, frame: Any) -> bool:
        return (frame.height, frame.width) == self.shape and frame.format.name == self.name

    def convert(self, frame: Any, path: Path, number: int) -> Frames:
        if self.is_rgb:
            rgb = frame.to_ndarray(format="rgb24")
            if np.any(rgb[..., 1:] != rgb[..., :1]):
                raise FingerflowError(f"{path}: frame {number} has real colour ({self.name}); convert it to grey first")
            return np.ascontiguousarray(rgb[..., 0])
        values = np.frombuffer(frame.planes[0], self.stored).reshape(self.shape[0], -1)
        if self.name in PACKED_LUMA:
            values = values[:, PACKED_LUMA[self.name]]
        return (values[:, : self.shape[1]] >> self.stored.type(self.shift)).astype(self.dtype)


@contextmanager
def _reported_errors() -> Iterator[list[str]]:
    """Context manager that yields a list, which at the end of the context holds the messages of all errors that FFmpeg
    reported in any decoder thread.
    """
    messages: list[str] = []
    with _REPORTS:
        level = av.logging.get_level()
        av.logging.set_level(av.logging.ERROR)
        try:
            with av.logging.Capture(local=False) as logs:
                yield messages
            messages += [message.strip() for *_, message in logs]
        finally:
            av.logging.set_level(level)


def _open(path: Path) -> Any:
    with reading(path, "video"):
        return av.open(str(path), **_LENIENT)


def _first_picture(path: Path) -> tuple[bool, str]:
    """Return whether the first picture of a video is interlaced, and its display: "1", or the shape of pixels."""
    try:
        with _open(path) as container:
            wide = container.streams.video[0].sample_aspect_ratio or 1
            picture = next(container.decode(video=0))
    except (FingerflowError, av.FFmpegError, StopIteration, ValueError, MemoryError):
        return False, "1"  # reported as an unreadable frame
    matrix = picture.side_data.get("DISPLAYMATRIX")
    upright = matrix is None or np.array_equal(np.sign(np.frombuffer(bytes(matrix), np.int32)[:5]), (1, 0, 0, 0, 1))
    return picture.interlaced_frame, str(wide) if upright else "display matrix"


def _lossy(codec: Any) -> str | None:
    """Return the name of a video codec if the codec is lossy, else None.

    Lossless H.264 is recognised by its profile.
    """
    if codec.codec.lossless and not codec.codec.lossy:
        return None
    lossless = codec.name == "h264" and codec.profile == "High 4:4:4 Predictive" and "444" not in str(codec.pix_fmt)
    return None if lossless else str(codec.name)


def unfinished(path: Path) -> str:
    """Return how a Matroska file (MKV, WebM) is incomplete, as text; "" if it is complete or in another format.

    The program that writes the file states the segment's length only when it has finished; until then all of its bits
    are 1. Source: RFC 9559 (Matroska) and RFC 8794 (EBML), variable-size integers: writers give it 8 bytes, of which
    the first is 1.
    """
    with path.open("rb") as file:
        start, size = file.read(256), path.stat().st_size
    segment = start.find(b"\x18S\x80g\x01")
    if not start.startswith(b"\x1aE\xdf\xa3") or segment < 0:
        return ""
    length = start[segment + 5 : segment + 12]
    if length == b"\xff" * 7:
        return "the file was never finished"
    end = segment + 12 + int.from_bytes(length, "big")
    return f"the file has {size} of {end} bytes" if end > size else ""


def _pixels(path: Path, name: str | None, height: int, width: int) -> _Pixels:
    if name is None or height <= 0 or width <= 0 or height * width > MOST_PIXELS:
        raise FingerflowError(
            f"{path}: its header is damaged: frames of {height} x {width} pixels, format {name}; copy the file again"
        )
    layout = av.VideoFormat(name)
    bits = [component.bits for component in layout.components]
    is_rgb = layout.is_rgb or layout.has_palette
    grey = layout.is_planar or len(bits) == 1 or name in PACKED_LUMA
    unknown = name.startswith("bayer") or layout.is_bit_stream or not (grey or is_rgb)
    if unknown or max(bits) > (8 if is_rgb else 16):
        raise FingerflowError(
            f"{path}: pixel format {name} is not grey; known are grey and YUV of 8 to 16 bits, and RGB of 8 bits with "
            "equal channels. Convert the video, for example to FFV1 with gray or gray16le."
        )
    return _Pixels(
        name=name,
        shape=(height, width),
        dtype=np.dtype(np.uint8 if bits[0] <= 8 else np.uint16),
        bits=8 if is_rgb else bits[0],
        shift=16 - bits[0] if name.startswith(("p0", "p2", "p4")) else 0,  # P010 and similar formats use the upper bits
        stored=np.dtype(np.uint8 if bits[0] <= 8 else (">u2" if layout.is_big_endian else "<u2")),
        is_rgb=is_rgb,
        is_luma=not is_rgb and len(bits) > 1,
    )


def _index(path: Path, container: Any, stream: Any, entries: list[Any]) -> _Index:
    """Return the index of the video `stream` of an open file (`container`), whose own index has these `entries`."""
    size = path.stat().st_size
    if entries and len(entries) == stream.frames and not stream.codec_context.has_b_frames:
        packets = [(entry.timestamp, entry.is_keyframe, False) for entry in entries if entry.pos + entry.size <= size]
    else:
        packets = _packets(container, stream)
        while packets and packets[-1][2]:
            packets.pop()  # drop packets that are incomplete at the end of the file
    stamps = [stamp for stamp, *_ in packets]
    # AVI has no display order: FFmpeg's stamps of reordered frames differ from the decoder's.
    unordered = container.format.name == "avi" and stream.codec_context.has_b_frames
    if unordered or None in stamps or len(set(stamps)) < len(stamps):
        return _Index(len(packets), None, [0], {}, {})
    packets.sort()
    keys = [number for number, (_, is_key, _) in enumerate(packets) if is_key]
    numbers = {stamp: number for number, (stamp, *_) in enumerate(packets)}
    damaged = {number: "is marked as corrupt by the file" for number, packet in enumerate(packets) if packet[2]}
    return _Index(len(packets), np.array(sorted(stamps), np.int64), sorted({0, *keys}), numbers, damaged)


def _packets(container: Any, stream: Any) -> list[tuple[Any, bool, bool]]:
    """Return (time stamp, is key frame, is damaged) for each readable packet of a video stream in an open file
    (`container`).
    """
    packets: list[tuple[Any, bool, bool]] = []
    try:
        for packet in container.demux(stream):
            if packet.size and not packet.is_discard:
                packets.append((packet.pts, packet.is_keyframe, packet.is_corrupt))
    except av.FFmpegError:
        if not packets:
            raise
    return packets
