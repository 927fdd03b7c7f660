"""Unpacking of grey values of 10 and 12 bits without gaps, most significant bit first (Phantom, Photron cameras)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def unpack_10bit(packed: NDArray[np.uint8], count: int) -> NDArray[np.uint16]:
    """Return `count` values of 0 .. 1023 from groups of five bytes that hold four values each."""
    b0, b1, b2, b3, b4 = _groups(packed, 5)
    values = np.empty((len(b0), 4), np.uint16)
    values[:, 0] = b0 << 2 | b1 >> 6
    values[:, 1] = (b1 & 0x3F) << 4 | b2 >> 4
    values[:, 2] = (b2 & 0x0F) << 6 | b3 >> 2
    values[:, 3] = (b3 & 0x03) << 8 | b4
    return values.reshape(-1)[:count]


def unpack_12bit(packed: NDArray[np.uint8], count: int) -> NDArray[np.uint16]:
    """Return `count` values of 0 .. 4095 from groups of three bytes that hold two values each."""
    b0, b1, b2 = _groups(packed, 3)
    values = np.empty((len(b0), 2), np.uint16)
    values[:, 0] = b0 << 4 | b1 >> 4
    values[:, 1] = (b1 & 0x0F) << 8 | b2
    return values.reshape(-1)[:count]


def packed_bytes(count: int, bits: int) -> int:
    """Return the number of bytes of `count` values of `bits` bits; a frame starts on a whole byte."""
    return (count * bits + 7) // 8


def _groups(packed: NDArray[np.uint8], size: int) -> NDArray[np.uint16]:
    """Return (size, n): the first, second, ... byte of each group; an incomplete last group is padded with zeros."""
    padded = np.pad(packed, (0, -len(packed) % size))
    return padded.reshape(-1, size).T.astype(np.uint16)
