"""Helpers that write small recordings as cameras and FFmpeg do: Phantom (by its format description),
Photron, videos.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

TRIGGER = 1_437_678_836 * 2**32 + 2**31 + 3  # 32.32 fixed point; the lowest two bits are flags
OFFSETS_IN_SETUP = {  # offsets in SETUP, little endian, without padding
    "FrameRate16": (0, "<H"), "FrameRate": (768, "<I"), "Serial": (743, "<I"), "bFlipH": (756, "<i"),
    "bFlipV": (760, "<i"), "CameraVersion": (792, "<I"), "CFA": (808, "<I"), "Rotate": (884, "<i"),
    "RealBPP": (896, "<I"), "ShutterNs": (1568, "<I"), "BlackLevel": (5732, "<i"), "WhiteLevel": (5736, "<i"),
    "CameraModel": (12432, "<1024s"), "dFrameRate": (13472, "<d"),
}  # fmt: skip


@dataclass
class Cine:
    """Content of a Phantom recording. `pixels` holds the bytes of each frame, packed and in the order of the file."""

    width: int
    height: int
    pixels: list[bytes]
    bits: int = 16
    packing: int = 0
    compression: int = 0
    first_number: int = -2
    setup: dict[str, Any] = field(default_factory=dict)
    setup_length: int = 13480
    stamps: list[float] | None = None  # s from the trigger
    annotation: bytes = b""

    def write(self, path: Path) -> Path:
        path.write_bytes(self.bytes())
        return path

    def bytes(self) -> bytes:
        setup = bytearray(self.setup_length)
        setup[140:142] = b"ST"
        struct.pack_into("<H", setup, 142, self.setup_length)
        for name, value in ({"FrameRate": 300, "RealBPP": 12, "Serial": 4711} | self.setup).items():
            offset, code = OFFSETS_IN_SETUP[name]
            if offset + struct.calcsize(code) <= self.setup_length:
                struct.pack_into(code, setup, offset, value)
        blocks = b""
        if self.stamps is not None:
            ticks = [(TRIGGER & ~3) + round(stamp * 2**30) * 4 + 3 for stamp in self.stamps]
            blocks += struct.pack("<IHH", 8 + 16, 1007, 1) + bytes(16)  # a block that the reader must skip
            blocks += struct.pack("<IHH", 8 + 8 * len(ticks), 1002, 1) + struct.pack(f"<{len(ticks)}Q", *ticks)
            exposures = struct.pack("<IHH", 8 + 4 * len(ticks), 1003, 0)
            blocks += exposures + struct.pack(f"<{len(ticks)}I", *[round(0.001 * 2**32)] * len(ticks))
        setup_at = 44 + 40
        table_at = setup_at + len(setup) + len(blocks)
        count = len(self.pixels)
        frames, offsets = b"", []
        for number, pixels in enumerate(self.pixels):
            annotation = self.annotation * number  # a different size for each frame
            offsets.append(table_at + 8 * count + len(frames))
            frames += struct.pack("<I", 8 + len(annotation)) + annotation + struct.pack("<I", len(pixels)) + pixels
        head = struct.pack(
            "<2sHHHiIiIIIIQ", b"CI", 44, self.compression, 1, self.first_number, count, self.first_number, count, 44,
            setup_at, table_at, TRIGGER,
        )  # fmt: skip
        bitmap = struct.pack(
            "<IiiHHIIiiII", 40, self.width, self.height, 1, self.bits, self.packing, len(self.pixels[0]), 0, 0, 0, 0
        )
        return head + bitmap + bytes(setup) + blocks + struct.pack(f"<{count}q", *offsets) + frames


def pack_bits(values: np.ndarray, bits: int) -> bytes:
    """Return values packed as one long binary number, the most significant bit first."""
    text = "".join(format(int(value), f"0{bits}b") for value in values.reshape(-1))
    text += "0" * (-len(text) % 8)
    return int(text, 2).to_bytes(len(text) // 8, "big")


PHOTRON_XML = """<cih><imageFileInfo><fileFormat>{File Format}</fileFormat></imageFileInfo>
<imageDataInfo><resolution><width>{Image Width}</width><height>{Image Height}</height></resolution>
<colorInfo><type>{Color Type}</type><bit>{Color Bit}</bit></colorInfo>
<effectiveBit><depth>{EffectiveBit Depth}</depth><side>{EffectiveBit Side}</side></effectiveBit></imageDataInfo>
<frameInfo><totalFrame>{Total Frame}</totalFrame><startFrame>{Start Frame}</startFrame>
<skipFrame>{Save Step}</skipFrame></frameInfo><recordInfo><recordRate>{Record Rate(fps)}</recordRate>
<shutterSpeedNsec>{Shutter Type2(nsec)}</shutterSpeedNsec></recordInfo>
<deviceInfo><deviceName>{Camera Type}</deviceName></deviceInfo></cih>"""


def write_photron(folder: Path, data: bytes, header: str = ".cih", **changes: object) -> Path:
    """Write `take 1.mraw` and its header, text or XML; `changes` are entries, with _ for blanks in their names."""
    entries = {
        "Camera Type": "FASTCAM SA-Z type 2100K-M-64GB",
        "Record Rate(fps)": 3000,
        "Shutter Type2(nsec)": 65060,
        "Total Frame": 6,
        "Start Frame": -20,
        "Save Step": 10,
        "Image Width": 8,
        "Image Height": 5,
        "Color Type": "Mono",
        "Color Bit": 16,
        "File Format": "MRaw",
        "EffectiveBit Depth": 12,
        "EffectiveBit Side": "Lower",
    } | {name.replace("_", " "): value for name, value in changes.items()}
    text = "#Camera Information Header\r\nComment Text : mesure \xe0 5 N\r\n"
    text += "".join(f"{name} : {value}\r\n" for name, value in entries.items())
    text += "\r\nEND\r\nImage Width : 999\r\n"
    if header == ".cihx":
        text = f"\0\xffCIHX{PHOTRON_XML.format_map(entries)}\x01\x02"
    (folder / "take 1.mraw").write_bytes(data)
    (folder / f"take 1{header}").write_bytes(text.encode("latin-1"))
    return folder / "take 1.mraw"


def write_video(
    path: Path, frames: np.ndarray, codec: str, pixels: str, rate: int = 300, ticks: Sequence[int] = (), **options: str
) -> Path:
    """Encode grey frames (N, H, W) or colour frames (N, H, W, 3) with time stamps in ticks of 1 / `rate` s; planes are
    filled directly, without conversion.
    """
    _, height, width = frames.shape[:3]
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=Fraction(rate), options=options)
        stream.width, stream.height, stream.pix_fmt = width, height, pixels
        for tick, values in zip(ticks or range(len(frames)), frames, strict=True):
            frame = av.VideoFrame(width, height, pixels)
            for plane_number, plane in enumerate(frame.planes):
                buffer = np.frombuffer(plane, values.dtype).reshape(plane.height, -1).copy()
                if pixels in ("bgr24", "rgb24"):
                    buffer[:, : 3 * width] = (
                        np.repeat(values, 3, axis=1) if values.ndim == 2 else values.reshape(height, -1)
                    )
                elif plane_number == 0:
                    buffer[:, :width] = values
                else:
                    buffer[:] = 128 if values.itemsize == 1 else 512  # no colour, in 8 or 10 bits
                plane.update(buffer.tobytes())
            frame.pts, frame.time_base = tick, Fraction(1, rate)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path
