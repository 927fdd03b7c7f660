"""Check of the sizes that headers of image and array files claim, before a library allocates memory for them."""

import struct

MOST_NPY_HEADER = 1 << 16  # bytes, largest header of a NumPy file; NumPy itself reads no more than 10,000
MOST_PIXELS = 1 << 28  # 16384 x 16384 pixels; the largest cameras have 250 million
# Largest number of bytes to which one compressed byte can expand: the limit of deflate (zlib's technical notes). Image
# codecs stay below it.
MOST_COMPRESSED = 1032
_ALWAYS = 1 << 20  # pixels that a file of any size may have
_PNG = b"\x89PNG\r\n\x1a\n"
_NO_SIZE = {0x01, *range(0xD0, 0xDA)}  # JPEG markers without a length
_SIZES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # JPEG markers of a frame header, which holds the image size


def impossible_picture(data: bytes | memoryview) -> str:
    """Return why the image size claimed in a PNG, JPEG or BMP file is impossible for its length; "" if it is possible.

    The text continues a sentence that begins with the name of the file.
    """
    height, width = picture_size(data) or (1, 1)
    if not 0 < height * width <= min(MOST_PIXELS, MOST_COMPRESSED * len(data) + _ALWAYS):
        return f"its header says {height} x {width} pixels, which a file of {len(data)} bytes cannot hold"
    at = 8
    while data[:8] == _PNG and at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        at += 12 + length
        if at > len(data):
            return f"a part of it should have {length} bytes, and the file has {len(data)}"
    return ""


def picture_size(data: bytes | memoryview) -> tuple[int, int] | None:
    """Return the image size (height, width) in the header of a PNG, JPEG or BMP file; None without such a header."""
    if data[:8] == _PNG and len(data) >= 24:
        width, height = struct.unpack_from(">II", data, 16)
        return height, width
    if data[:2] == b"BM" and len(data) >= 26:
        (header,) = struct.unpack_from("<I", data, 14)
        width, height = struct.unpack_from("<HH" if header == 12 else "<ii", data, 18)
        return abs(height), abs(width)
    if data[:2] == b"\xff\xd8":
        return _jpeg_size(data)
    return None


def npy_header_bytes(start: bytes) -> int:
    """Return the header length in bytes of a NumPy file, given the first 12 bytes; 0 for any other file."""
    if start[:6] != b"\x93NUMPY" or len(start) < 12:
        return 0
    return int.from_bytes(start[8:10] if start[6] == 1 else start[8:12], "little")


def _jpeg_size(data: bytes | memoryview) -> tuple[int, int] | None:
    at = 2
    while at + 9 <= len(data):
        if data[at] != 0xFF:
            return None
        marker = data[at + 1]
        if marker == 0xFF:  # skip a fill byte
            at += 1
        elif marker in _SIZES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return height, width
        elif marker in _NO_SIZE:
            at += 2
        else:
            (length,) = struct.unpack_from(">H", data, at + 2)
            at += 2 + max(length, 2)
    return None
