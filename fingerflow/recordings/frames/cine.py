"""Reader of Phantom `.cine` recordings (Vision Research) with 8, 10, 12 or 16 bits per pixel.

Source of the layout: "Cine File Format", Vision Research; fields have the names used there. Where other readers
disagree, the file's own fields decide; comments state which.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.recordings.frames.packing import packed_bytes, unpack
from fingerflow.recordings.frames.recording import Description, FrameFile, Frames, Recording, surplus

CINE_FILE_HEADER = struct.Struct("<2sHHHiIiIIIIQ")
BITMAP_INFO_HEADER = struct.Struct("<IiiHHIIiiII")
TAG_HEADER = struct.Struct("<IHH")
TIME_ONLY, EXPOSURE_ONLY = 1002, 1003  # codes of tagged blocks between SETUP and the image offsets
UNCOMPRESSED, PACKED_10, PACKED_12 = 0, 256, 1024  # values of biCompression

# SETUP grew with each software version, so a field exists only if it ends within SETUP.Length.
SETUP_FIELDS = {
    "FrameRate16": (0, "<H"),
    "Length": (142, "<H"),
    "Serial": (743, "<I"),
    "bFlipH": (756, "<i"),
    "bFlipV": (760, "<i"),
    "FrameRate": (768, "<I"),
    "CameraVersion": (792, "<I"),
    "CFA": (808, "<I"),
    "Rotate": (884, "<i"),
    "RealBPP": (896, "<I"),
    "ShutterNs": (1568, "<I"),
    "BlackLevel": (5732, "<i"),
    "WhiteLevel": (5736, "<i"),
    "CameraModel": (12432, "<1024s"),
    "dFrameRate": (13472, "<d"),
}

# (1024,) uint16: 12-bit linear value of each 10-bit code, from "Cine File Format", Vision Research, appendix 1. The
# camera compresses 12 bits to 10 with the curve of ITU-R BT.709 between black (64 in both) and white (4064 of 4095,
# code 1014 of 1023). The table is used because other readers use it; the formula differs from it by up to 2.4 counts.
LINEAR_OF_COMPANDED = np.array(Path(__file__).with_name("cine_companding.txt").read_text("ascii").split(), np.uint16)


def open_frames(path: Path) -> Recording:
    """Open a Phantom recording, reading headers and image offsets only; raise FingerflowError for colour or damage."""
    size = path.stat().st_size
    data = np.memmap(path, np.uint8, "r") if size else np.empty(0, np.uint8)
    if size < CINE_FILE_HEADER.size or data[:2].tobytes() != b"CI":
        raise FingerflowError(
            f"{path}: not a Phantom recording: it starts with {data[:2].tobytes()!r}, not with a header of type b'CI'"
        )
    (_, _, compression, version, _, _, first_number, count, image_header, setup_at, offsets_at, trigger) = (
        CINE_FILE_HEADER.unpack_from(data.data)
    )
    if version != 1:
        raise FingerflowError(f"{path}: version {version} of the Cine format; only version 1 is known")
    if offsets_at >= size or image_header + BITMAP_INFO_HEADER.size > size:
        raise FingerflowError(f"{path}: ends after {size} bytes, before the table of its frames; copy it again")
    header = data[:offsets_at].data
    table = np.frombuffer(data, "<i8", min(count, (size - offsets_at) // 8), offsets_at)
    setup = _setup(header[setup_at:])
    if bytes(header[setup_at + 140 : setup_at + 142]) != b"ST":
        raise FingerflowError(
            f"{path}: SETUP, with rate and bit depth, is not at byte {setup_at}, as its header says; copy it again"
        )
    layout = _layout(path, compression, BITMAP_INFO_HEADER.unpack_from(data.data, image_header), setup)
    blocks = _tagged_blocks(header, setup_at + (setup["Length"] or 0))
    whole = _whole_frames(table, layout.image_bytes, data)
    if whole == 0:
        raise FingerflowError(f"{path}: not one of its {count} frames is there whole; copy the file again")

    # Bytes after the last frame; less than a frame may be an annotation.
    behind = size - int(table[:whole].max()) - 8 - layout.image_bytes
    warnings = [
        f"{name} is set: a player would turn the picture; the frames here are as the sensor recorded them"
        for name in ("bFlipH", "bFlipV", "Rotate")
        if setup[name]
    ]
    rate = setup["dFrameRate"] or setup["FrameRate"] or setup["FrameRate16"] or None
    # TIME64 counts 2**-32 s since 1970; its two lowest bits are flags. Stamps are subtracted as integers, because a
    # double would round the difference to 0.2 us.
    stored = blocks.get(TIME_ONLY, b"")
    ticks = np.frombuffer(stored, "<u8", len(stored) // 8)[:whole]
    stamps = ((ticks >> 2).astype(np.int64) - (trigger >> 2)) / 2.0**30  # s from the trigger
    times, rate, complaints = _times(stamps, first_number, None if rate is None else float(rate))
    start = float(first_number) if times is None or rate is None else float(times[0] * rate)
    if len(stamps) < whole:
        times = None
    description = Description(
        path=path,
        count=whole,
        stated_count=count,
        frame_shape=layout.shape,
        dtype=layout.dtype,
        bit_depth=layout.bit_depth,
        frame_rate=rate,
        first_number=start,
        has_trigger=True,
        time_stamps=times,
        warnings=(*warnings, *complaints, *(surplus(behind, layout.image_bytes, count) if whole == count else ())),
        metadata=_metadata(setup, layout, first_number, blocks.get(EXPOSURE_ONLY)),
    )
    return Recording(description, FrameFile(description, partial(_frame, path, data, table[:whole], layout)))


def _frame(path: Path, data: NDArray[np.uint8], offsets: NDArray[np.int64], layout: _CineLayout, index: int) -> Frames:
    """Return frame `index` of a `.cine` file as grey values (H, W), given the bytes of the file, `data`, and the byte
    offset of each frame.
    """
    # AnnotationSize counts itself, the annotation and the ImageSize that follows it.
    start = int(offsets[index])
    start += _unsigned(data[start : start + 4])
    image_bytes = _unsigned(data[start - 4 : start])
    if image_bytes != layout.image_bytes:
        raise FingerflowError(f"{path}: frame {index} has {image_bytes} bytes instead of {layout.image_bytes}")
    return layout.pixels(np.asarray(data[start : start + image_bytes]))


@dataclass(frozen=True)
class _CineLayout:
    """Pixel layout of an image in a `.cine` file, which determines how bytes are converted to grey values."""

    shape: tuple[int, int]
    dtype: np.dtype[Any]
    bit_depth: int
    compression: int
    image_bytes: int
    bottom_up: bool

    def pixels(self, data: NDArray[np.uint8]) -> Frames:
        height, width = self.shape
        if self.compression == PACKED_10:
            # The 10 bits are companded: light is proportional to the 12-bit values of the table, not to them.
            image = LINEAR_OF_COMPANDED[unpack(data, 10, self.shape)]
        elif self.compression == PACKED_12:
            image = unpack(data, 12, self.shape)
        else:
            rows = data.reshape(height, -1)[:, : width * self.dtype.itemsize]  # rows may be padded to 4 bytes
            image = np.ascontiguousarray(rows).view(self.dtype.newbyteorder("<")).astype(self.dtype)
        return np.ascontiguousarray(image[::-1]) if self.bottom_up else image


def _unsigned(data: NDArray[np.uint8]) -> int:
    return int.from_bytes(data.tobytes(), "little")


def _setup(data: memoryview) -> dict[str, Any]:
    """Return the fields of the SETUP structure of a `.cine` file, by name; None for fields that it does not have."""
    offset, code = SETUP_FIELDS["Length"]
    length = struct.unpack_from(code, data, offset)[0] if len(data) >= offset + struct.calcsize(code) else 0
    fields = {}
    for name, (offset, code) in SETUP_FIELDS.items():
        there = offset + struct.calcsize(code) <= min(length, len(data))
        value = struct.unpack_from(code, data, offset)[0] if there else None
        fields[name] = value.split(b"\0")[0].decode("latin-1") if isinstance(value, bytes) else value
    return fields


def _layout(path: Path, compression: int, bitmap: tuple[int, ...], setup: dict[str, Any]) -> _CineLayout:
    _, width, signed_height, _, bits, packing, image_bytes, *_ = bitmap
    height = abs(signed_height)
    # biCompression states the kind of pixels, whatever the sensor's colour filter. 2 is uninterpolated colour, 1 is
    # JPEG, 0 with 24 or 48 bits is interpolated colour, and 0 with 8 or 16 bits is grey.
    if compression == 2 or bits in (24, 48):
        pixels = "raw pixels behind a colour filter" if compression == 2 else f"colour pixels of {bits} bits"
        remedy = "Convert it to grey in the camera's software first."
        raise FingerflowError(f"{path}: a colour recording ({pixels}, CFA = {setup['CFA']}). {remedy}")
    if compression != 0 or bits not in (8, 16) or packing not in (UNCOMPRESSED, PACKED_10, PACKED_12):
        raise FingerflowError(
            f"{path}: Compression {compression}, biCompression {packing}, biBitCount {bits} is not known. Known grey "
            "frames are 8 and 16 bits uncompressed (0, 0), 10 bits packed (0, 256) and 12 bits packed (0, 1024)"
        )
    if packing == UNCOMPRESSED:
        row_bytes = image_bytes // height if height else 0
        expected = width * bits // 8
        fits = row_bytes * height == image_bytes and row_bytes in (expected, -(-expected // 4) * 4)
        depth = setup["RealBPP"] if setup["RealBPP"] and setup["RealBPP"] <= bits else bits
    else:
        expected = packed_bytes(width * height, 10 if packing == PACKED_10 else 12)
        fits = image_bytes == expected
        depth = 12
    if not fits or width <= 0 or height <= 0:
        raise FingerflowError(
            f"{path}: biSizeImage is {image_bytes} bytes, which is not a frame of {width} x {height} pixels of {bits} "
            f"bits (biCompression {packing})"
        )
    return _CineLayout(
        shape=(height, width),
        dtype=np.dtype(np.uint8 if packing == UNCOMPRESSED and bits == 8 else np.uint16),
        bit_depth=depth,
        compression=packing,
        image_bytes=image_bytes,
        # An uncompressed image is a Windows bitmap, whose last row comes first unless biHeight is negative. A packed
        # image has the order of the camera, with the first row first.
        bottom_up=packing == UNCOMPRESSED and signed_height > 0,
    )


def _tagged_blocks(header: memoryview, start: int) -> dict[int, memoryview]:
    blocks = {}
    while start + TAG_HEADER.size <= len(header):
        size, tag, _ = TAG_HEADER.unpack_from(header, start)
        if size < TAG_HEADER.size:
            break
        blocks[tag] = header[start + TAG_HEADER.size : start + size]
        start += size
    return blocks


def _whole_frames(offsets: NDArray[np.int64], image_bytes: int, data: NDArray[np.uint8]) -> int:
    """Return how many frames of a `.cine` file, from the first one on, are stored completely, given the byte offset of
    each frame and the bytes of an image.
    """
    ends_too_late = (offsets <= 0) | (offsets + 8 + image_bytes > data.size)
    count = int(np.argmax(ends_too_late)) if ends_too_late.any() else len(offsets)
    while count:
        start = int(offsets[count - 1])
        if start + _unsigned(data[start : start + 4]) + image_bytes <= data.size:
            break
        count -= 1
    return count


def _times(
    stamps: NDArray[np.float64], first_number: int, rate: float | None
) -> tuple[NDArray[np.float64] | None, float | None, list[str]]:
    """Return frame times (s from the trigger), frame rate (Hz) and warnings for the user, according to the camera's
    time stamps; the times are None if the stamps do not increase.

    FrameRate is the setting of the camera; if frames were left out on saving, only the time stamps show it. Frame
    numbers count from the trigger, but in some cameras numbers and clock disagree by minutes.
    """
    if len(stamps) < 2 or np.any(np.diff(stamps) <= 0):
        unusable = "the camera's time stamps do not increase: times are from the frame rate"
        return None, rate, [unusable] if len(stamps) > 1 else []
    warnings = []
    steps = np.diff(stamps)
    regular = steps <= 1.5 * np.median(steps)
    measured = 1.0 / float(np.mean(steps[regular]))
    if not regular.all():
        gap = int(np.argmax(~regular))
        warnings.append(
            f"{int(np.sum(~regular))} gaps in the time stamps, the first of {steps[gap] * measured - 1:.0f} frames "
            f"after frame {gap}"
        )
    # Largest relative difference of the rates; the clock ticks in microseconds.
    tolerance = 0.01 + 2e-6 / float(np.sum(steps[regular]))
    if rate is None or abs(measured / rate - 1) > tolerance:
        if rate is not None:
            warnings.append(
                f"the header says {rate:g} Hz but the time stamps are {measured:g} Hz apart; the stamps count"
            )
        rate = measured
    by_number = first_number / rate
    if abs(stamps[0]) > 86400:
        warnings.append(
            f"the first frame lies {stamps[0]:.0f} s from the trigger by the clock, which was reset in between; "
            f"by its number it lies {by_number:g} s from it, and that counts"
        )
        return stamps - stamps[0] + by_number, rate, warnings
    if abs(stamps[0] - by_number) > 1.5 / rate:
        warnings.append(
            f"the first frame lies {stamps[0]:g} s after the trigger by its time stamp, {by_number:g} s by its number "
            f"{first_number}; the stamps count"
        )
    return stamps, rate, warnings


def _metadata(
    setup: dict[str, Any], layout: _CineLayout, first_number: int, exposures: memoryview | None
) -> dict[str, Any]:
    exposure = np.frombuffer(exposures, "<u4", 1)[0] / 2.0**32 if exposures else (setup["ShutterNs"] or 0) * 1e-9
    levels = {"black_level": setup["BlackLevel"], "white_level": setup["WhiteLevel"]}
    if layout.compression == PACKED_10:
        levels = {
            name: None if level is None else int(LINEAR_OF_COMPANDED[min(max(level, 0), 1023)])
            for name, level in levels.items()
        }
    packing = {UNCOMPRESSED: "none", PACKED_10: "10 bit companded", PACKED_12: "12 bit linear"}[layout.compression]
    values = {
        "camera": setup["CameraModel"] or (f"Phantom v{setup['CameraVersion']}" if setup["CameraVersion"] else None),
        "serial": setup["Serial"],
        "exposure_s": float(exposure) or None,
        "first_frame_number": first_number,
        "packing": packing,
        **levels,
    }
    return {name: value for name, value in values.items() if value is not None}
