"""Helper that writes HDF5 files whose index of chunks is damaged, one entry at a time."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

KEY = struct.Struct("<IIQQQQ")  # chunk in a B-tree, version 1: stored bytes, filter mask, offset, offset in an element


def damaged_indexes(path: Path, frames: np.ndarray, **options: Any) -> Iterator[str]:
    """Write `frames`, one per chunk, to `path` with one damaged entry of the index; yield a description
    of the damage.
    """
    with h5py.File(path, "w", libver="earliest") as file:
        file.create_dataset("x", data=frames, chunks=(1, *frames.shape[1:]), **options)
        chunks = [file["x"].id.get_chunk_info(number) for number in range(len(frames))]
    whole = path.read_bytes()
    keys = [whole.index(KEY.pack(one.size, 0, *one.chunk_offset, 0)) for one in chunks]
    last = keys[-1] + KEY.size + 8  # the upper bound after the last chunk
    assert KEY.unpack_from(whole, last)[2] == len(frames) - 1

    def changed(name: str, at: int, code: str, value: int) -> str:
        path.write_bytes(whole[:at] + struct.pack(code, value) + whole[at + struct.calcsize(code) :])
        return name

    size, address = chunks[2].size, chunks[2].byte_offset
    for short in range(4):
        yield changed(f"size of a chunk {short}", keys[2], "<I", short)
    yield changed("size of a chunk too large", keys[2], "<I", size + 40)
    yield changed("size of a chunk beyond the file", keys[2], "<I", 2**31)
    yield changed("filters of a chunk left out", keys[2] + 4, "<I", 7)
    yield changed("place of a chunk outside the grid", keys[2] + 8, "<Q", len(frames) + 3)
    yield changed("place of a chunk twice", keys[2] + 8, "<Q", 1)
    yield changed("place of a chunk beside the grid", keys[2] + 16, "<Q", 1)
    yield changed("place of the end", last + 8, "<Q", len(frames) - 2)
    for name, to in (("0", 0), ("of another", chunks[1].byte_offset), ("beyond the file", len(whole)),
                     ("shifted", address + 8), ("undefined", 2**64 - 1)):  # fmt: skip
        yield changed(f"address of a chunk {name}", keys[2] + KEY.size, "<Q", to)
