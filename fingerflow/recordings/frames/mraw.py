"""Reader of Photron recordings: pixels in an `.mraw` file, header in a `.cih` (text) or `.cihx` (XML) file.

Source: the headers that Photron FASTCAM Viewer writes; keys are quoted as they stand there.
"""

import contextlib
import math
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.recordings.frames.packing import packed_bytes, unpack
from fingerflow.recordings.frames.recording import Description, FrameFile, Frames, Recording, surplus
from fingerflow.schema.text_file import check_file

HEADERS = (".cihx", ".cih")
MOST_HEADER_BYTES = 1 << 24  # headers of cameras have 10 kB, or 1 MB with a preview image

# Names of entries in the text header, and their paths in the XML header.
XML_PLACES = {
    "Camera Type": "deviceInfo/deviceName",
    "Record Rate(fps)": "recordInfo/recordRate",
    "Shutter Type2(nsec)": "recordInfo/shutterSpeedNsec",
    "Total Frame": "frameInfo/totalFrame",
    "Start Frame": "frameInfo/startFrame",
    "Save Step": "frameInfo/skipFrame",
    "Image Width": "imageDataInfo/resolution/width",
    "Image Height": "imageDataInfo/resolution/height",
    "Color Type": "imageDataInfo/colorInfo/type",
    "Color Bit": "imageDataInfo/colorInfo/bit",
    "EffectiveBit Depth": "imageDataInfo/effectiveBit/depth",
    "EffectiveBit Side": "imageDataInfo/effectiveBit/side",
    "File Format": "imageFileInfo/fileFormat",
}


def open_frames(path: Path) -> Recording:
    """Open a Photron recording, given the path of either the pixel file or the header file."""
    if path.suffix.lower() == ".mraw":
        pixels, header_path = path, _find_partner(path, HEADERS, "its header, a .cih or .cihx file")
    else:
        pixels, header_path = _find_partner(path, (".mraw",), "its pixels, a .mraw file"), path
    check_file(pixels)
    if check_file(header_path) > MOST_HEADER_BYTES:
        raise FingerflowError(
            f"{header_path}: has {header_path.stat().st_size} bytes, more than a Photron header; is it one?"
        )
    header = _Header(header_path)
    shape, bits, sensor_bits, shift = _layout(header)
    frame_bytes = packed_bytes(math.prod(shape), bits)
    dtype = np.dtype(np.uint8 if bits == 8 else np.uint16)
    count = header.integer("Total Frame")
    whole = min(count, pixels.stat().st_size // frame_bytes)
    if whole == 0:
        stated = f"by {header_path.name} a frame has {frame_bytes} bytes and there are {count}"
        raise FingerflowError(f"{pixels}: holds {pixels.stat().st_size} bytes, not one frame; {stated}")
    # Only one in "Save Step" recorded frames was saved, so the rate of the saved frames is "Record Rate" / "Save Step".
    if not header.text("Save Step", " ").strip():
        header.warnings += (
            f"{header_path.name} does not state 'Save Step': every recorded frame is taken to be stored",
        )
    step = header.integer("Save Step", 1) or 1
    if step < 1 or count < 1:
        raise FingerflowError(f"{header_path}: 'Save Step' is {step} and 'Total Frame' {count}; correct the header")
    rate = header.number("Record Rate(fps)") / step
    if rate <= 0:
        raise FingerflowError(f"{header_path}: 'Record Rate(fps)' is {rate * step:g}; correct the header")
    exposure = header.number("Shutter Type2(nsec)", 0.0) * 1e-9
    description = Description(
        path=path,
        count=whole,
        stated_count=count,
        frame_shape=shape,
        dtype=dtype,
        bit_depth=min(sensor_bits, bits),
        frame_rate=rate,
        first_number=header.integer("Start Frame", 0) / step,  # "Start Frame" counts recorded frames from the trigger
        has_trigger=bool(header.text("Start Frame", " ").strip()),
        warnings=(*header.warnings, *surplus(pixels.stat().st_size - count * frame_bytes, frame_bytes, count)),
        metadata={
            "camera": header.text("Camera Type", "Photron"),
            "sensor_bits": sensor_bits,
            **({"exposure_s": exposure} if exposure else {}),
        },
    )
    stored = np.memmap(pixels, np.uint8, "r", 0, (whole, frame_bytes))
    if bits == 12 or shift:
        return Recording(description, FrameFile(description, partial(_decoded, stored, bits, shift, shape)))
    return Recording(description, FrameFile(description, stored.view(dtype.newbyteorder("<")).reshape(whole, *shape)))


def _decoded(stored: NDArray[np.uint8], bits: int, shift: int, shape: tuple[int, int], index: int) -> Frames:
    """Return frame `index` as grey values (H, W), from the stored bytes of N frames (N, bytes) whose pixels are packed
    or bit-shifted.
    """
    data = np.asarray(stored[index])
    if bits == 12:
        return unpack(data, 12, shape)
    return (data.view("<u2") >> np.uint16(shift)).reshape(shape)


class _Header:
    """Entries of a Photron header file (`.cih` or `.cihx`), under the entry names of a `.cih` file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        data = path.read_bytes()
        self.warnings: tuple[str, ...] = ()
        if path.suffix.lower() == ".cihx":
            # The XML part lies between binary blocks of the camera's software.
            start, end = data.find(b"<cih>"), data.find(b"</cih>")
            try:
                root = ElementTree.fromstring(data[start : end + len(b"</cih>")].decode("utf-8", "replace"))
            except ElementTree.ParseError as error:
                raise FingerflowError(
                    f"{path}: no readable <cih> section ({error}); export the recording again"
                ) from None
            self._entries = {name: root.findtext(location, "").strip() for name, location in XML_PLACES.items()}
        else:
            self._entries, whole = _text_entries(data)
            if not whole:
                self.warnings = (f"the header {path.name} has no line END: it was cut, or written by another program",)

    def text(self, name: str, default: str | None = None) -> str:
        value = self._entries.get(name) or default
        if value is None:
            raise FingerflowError(
                f"{self.path}: has no entry {name!r}; is it the header of a Photron recording? Copy it again"
            )
        return value

    def number(self, name: str, default: float | None = None) -> float:
        value = self.text(name, None if default is None else str(default))
        with contextlib.suppress(ValueError):
            if math.isfinite(number := float(value)):
                return number
        raise FingerflowError(f"{self.path}: {name!r} is {value!r}, which is not a number; correct the header")

    def integer(self, name: str, default: int | None = None) -> int:
        value = self.number(name, default)
        if not (value.is_integer() and abs(value) < 2**53):
            raise FingerflowError(
                f"{self.path}: {name!r} is {value:g}, which is not a whole number; correct the header"
            )
        return int(value)


def _text_entries(data: bytes) -> tuple[dict[str, str], bool]:
    """Return all entries of a `.cih` header file, and whether the file ends with the line END."""
    entries: dict[str, str] = {}
    # Cameras write comments in their local encoding; latin-1 decodes any byte and leaves ASCII unchanged.
    lines = data.decode("latin-1").splitlines(keepends=True)
    whole = any(line.strip() == "END" for line in lines)
    if not whole and lines and not lines[-1].endswith(("\r", "\n")):
        lines.pop()  # drops an incomplete last line: "Depth : 1" may have been 12
    for line in lines:
        name, colon, value = line.partition(":")
        if colon:
            # The first section is kept; later sections belong to other programs.
            entries.setdefault(name.strip(), value.strip())
    return entries, whole


def _layout(header: _Header) -> tuple[tuple[int, int], int, int, int]:
    """Return height and width of frames, stored bits of a pixel, bits of the sensor, and by how many bits the values
    are stored too high.
    """
    path = header.path
    colour = header.text("Color Type", "Mono")
    bits = header.integer("Color Bit")
    if colour.lower() not in ("mono", "raw") or bits > 16 or "-C-" in header.text("Camera Type", ""):
        # "Raw" is the sensor's output: grey for a monochrome camera, a colour mosaic for a type "...-C-...".
        raise FingerflowError(
            f"{path}: a colour recording ({header.text('Camera Type', 'unknown')}, Color Type {colour}, {bits} bits). "
            "Convert it to grey in the camera's software first."
        )
    if header.text("File Format", "MRaw").lower() != "mraw" or bits not in (8, 12, 16):
        raise FingerflowError(
            f"{path}: File Format {header.text('File Format')!r} with Color Bit {bits} is not known; "
            "known is MRaw of 8, 12 or 16 bits"
        )
    width, height = header.integer("Image Width"), header.integer("Image Height")
    if bits == 16:
        # The effective depth must be stated, since a wrong guess would scale the grey values by up to 16.
        for name in ("EffectiveBit Depth", "EffectiveBit Side") if header.warnings else ("EffectiveBit Depth",):
            if not header.text(name, "").strip():
                raise FingerflowError(
                    f"{path}: does not state {name!r}, without which 16 bits a pixel say nothing; copy the header "
                    f"again, or add the line '{name} : ...' as the camera has it"
                )
    sensor_bits = header.integer("EffectiveBit Depth", bits)
    depth = min(sensor_bits, bits)
    if depth < 1 or width < 1 or height < 1:
        raise FingerflowError(f"{path}: frames of {width} x {height} pixels with {depth} bits cannot be")
    side = header.text("EffectiveBit Side", "Lower").lower()
    # With side "Higher", the sensor's 12 bits are stored times 16 and are shifted down here. An 8-bit file of a 12-bit
    # sensor has lost the other four bits already.
    shift = bits - depth if side == "higher" and bits == 16 else 0
    return (height, width), bits, sensor_bits, shift


def _find_partner(path: Path, suffixes: tuple[str, ...], what: str) -> Path:
    for suffix in suffixes:
        for candidate in path.parent.iterdir():
            if candidate.stem == path.stem and candidate.suffix.lower() == suffix:
                return candidate
    raise FingerflowError(f"{path}: {what} of the same name, is not beside it in {path.parent}")
