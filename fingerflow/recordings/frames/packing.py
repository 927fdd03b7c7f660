"""Unpacking of grey values stored in 10 or 12 bits without gaps, as Phantom and Photron cameras do."""

import numpy as np
from numpy.typing import NDArray


def unpack(packed: NDArray[np.uint8], bits: int, shape: tuple[int, int]) -> NDArray[np.uint16]:
    """Return an image of `shape` (H, W) from packed grey values of 10 bits (four in 5 bytes) or 12 bits (two in 3
    bytes).
    """
    size, values_in_group = (5, 4) if bits == 10 else (3, 2)
    padded = np.pad(packed, (0, -len(packed) % size))  # completes the last group with zeros
    group = padded.reshape(-1, size).T.astype(np.uint16)
    values = np.empty((group.shape[1], values_in_group), np.uint16)
    for number in range(values_in_group):
        byte, bit = divmod(number * bits, 8)  # byte and bit where the value begins; it ends within the next byte
        two_bytes = group[byte] << 8 | group[byte + 1]
        values[:, number] = two_bytes >> (16 - bit - bits) & (1 << bits) - 1
    return values.reshape(-1)[: shape[0] * shape[1]].reshape(shape)


def packed_bytes(count: int, bits: int) -> int:
    """Return the number of bytes that `count` packed values of `bits` bits occupy, rounded up."""
    return (count * bits + 7) // 8
