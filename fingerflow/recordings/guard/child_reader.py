"""Traversal of files in a child process, since libraries crash, loop or exhaust memory on damaged files.

Run as a script, it reads a line of JSON a file, with path and kind, and answers in a line each. It performs the same
operations as the readers on everything that they may access. Exceptions are ignored, because the reader gets the same
ones. A signal or a limit ends only this process.
"""

import base64
import importlib
import io
import json
import math
import os
import sys
from collections.abc import Callable
from itertools import pairwise
from typing import Any

CPU_SECONDS = 10.0  # s of CPU time for one file; a thousand objects take 0.1 s
MEMORY_BYTES = 1 << 27  # bytes of memory in addition to the libraries and the unpacked content of the file
VIDEO_BYTES = 3 << 28  # bytes of memory for videos instead of MEMORY_BYTES, since decoders keep frames
MOST_COMPRESSED = 1032  # same value as in `schema.claimed_sizes`, which this script does not import
MOST_OBJECTS = 100_000
MOST_ATTRIBUTE_BYTES = 1 << 26
# Numbers of the HDF5 filters that keep the length of a chunk, except for a checksum; length of the checksum.
SHUFFLE, FLETCHER32, CHECKSUM_BYTES = 2, 3, 4


def main() -> None:
    """Read requests, each a line with path and kind of a file, from standard input; traverse each file and print an
    answer, until the input ends.
    """
    print(json.dumps("ready"), flush=True)
    for line in sys.stdin:
        path, file_type = json.loads(line)
        through, libraries = READERS[file_type]
        for library in libraries:
            # Imported before the limit is set, as the memory of libraries depends on the number of CPUs.
            importlib.import_module(library)
        print(json.dumps(_run_with_limits(path, through)), flush=True)


def _run_with_limits(path: str, through: Callable[[str], Any]) -> Any:
    """Run the function `through`, which reads a file, with limits of time and memory; return its result, or an error
    text.
    """
    _limit_time(CPU_SECONDS)
    try:
        _limit_memory(path, VIDEO_BYTES if through is through_video else MEMORY_BYTES)
        return through(path)
    except MemoryError:
        return "its header asks for more memory than a file of its size can need"
    except Exception:
        return ""
    finally:
        _limit_time(0.0)


def through_hdf5(path: str) -> str:
    """Traverse objects, attributes and chunk indexes of an HDF5 file; return an error text, or "" on success."""
    import h5py

    count = 0

    def visit(_: str, item: Any) -> str | None:
        nonlocal count
        count += 1
        if count > MOST_OBJECTS:
            return f"it has more than {MOST_OBJECTS} objects"
        wrong = _attributes(item)
        if wrong is None and isinstance(item, h5py.Dataset):
            for name in ("shape", "dtype", "chunks", "compression", "fillvalue", "is_virtual", "external"):
                getattr(item, name)
            if item.chunks is not None:
                wrong = _wrong_chunks(item, os.path.getsize(path))
        return wrong

    with h5py.File(path, "r") as file:
        return _attributes(file) or file.visititems(visit) or ""


def through_matlab(path: str) -> str | dict[str, Any]:
    """Return the content of a MATLAB file in JSON types (:func:`as_json`), or an error text.

    SciPy reads some damaged files out of bounds, so that a file that was read here without a crash could crash
    elsewhere. Therefore the values themselves are passed on.
    """
    try:
        with open(path, "rb") as file:
            start = file.read(4096)
        wrong = through_hdf5(path) if b"\x89HDF\r\n\x1a\n" in start else ""
        return wrong or as_json(read_matlab(path))
    except MemoryError:
        raise
    except Exception as error:
        return f"it cannot be read ({type(error).__name__}: {str(error)[:120]})"


def read_matlab(path: str) -> Any:
    """Return all variables of a MATLAB file by name, with structs as mappings."""
    from pymatreader import read_mat

    return read_mat(path)


def as_json(value: Any) -> Any:
    """Convert values to JSON types, with numeric arrays as {".npy": base64} and None for unsupported types."""
    import numpy as np

    if isinstance(value, dict):
        return {str(name): as_json(item) for name, item in value.items()}
    if isinstance(value, str):
        return value
    try:
        numbers = np.asarray(value)
    except ValueError:  # a cell array with vectors of different lengths
        return None
    if numbers.dtype.kind not in "iuf":
        return None
    data = io.BytesIO()
    np.save(data, numbers, allow_pickle=False)
    return {".npy": base64.b64encode(data.getvalue()).decode("ascii")}


def through_tdms(path: str) -> str:
    """Traverse the metadata of all segments of a TDMS file; return "" on success."""
    from nptdms import TdmsFile

    with TdmsFile.open(path):
        return ""


def through_video(path: str) -> str:
    """Let FFmpeg read header, index and first frames of a video; return "" on success."""
    import av

    with av.open(path):
        return ""


READERS: dict[str, tuple[Callable[[str], Any], tuple[str, ...]]] = {
    "hdf5": (through_hdf5, ("h5py",)),
    "MATLAB": (through_matlab, ("h5py", "scipy.io", "pymatreader")),
    "TDMS": (through_tdms, ("nptdms",)),
    "video": (through_video, ("av",)),
}


def _wrong_chunks(values: Any, file_bytes: int) -> str | None:
    """Return a text that describes an error in the chunk index of an HDF5 data set, which HDF5 itself does not report;
    None if the index is correct.

    Each chunk has a place of its own in the grid and bytes of its own in the file, as many as its filters leave it.
    Chunks that were never written are allowed. HDF5 crashes on a chunk that is shorter than its checksum.
    """
    layout, shape, steps = values.id.get_create_plist(), values.shape, values.chunks
    filters = [layout.get_filter(number)[0] for number in range(layout.get_nfilters())]
    plain_bytes = math.prod(steps) * values.dtype.itemsize
    offsets = set()
    spans: list[tuple[int, int]] = []

    def check(chunk: Any) -> str | None:
        at, begin, end = chunk.chunk_offset, chunk.byte_offset, chunk.byte_offset + chunk.size
        applied = [code for bit, code in enumerate(filters) if not chunk.filter_mask >> bit & 1]
        expected = plain_bytes + CHECKSUM_BYTES * (FLETCHER32 in applied)
        if at in offsets or any(
            offset % step or offset >= most for offset, step, most in zip(at, steps, shape, strict=True)
        ):
            return f"chunk {at} is outside its grid, or there twice"
        if begin <= 0 or end > file_bytes:
            return f"chunk {at} is at bytes {begin} to {end} of a file of {file_bytes}"
        if FLETCHER32 in filters and (FLETCHER32 not in applied or chunk.size < CHECKSUM_BYTES):
            return f"chunk {at} of {chunk.size} bytes lacks its checksum"
        if set(applied) <= {SHUFFLE, FLETCHER32} and chunk.size != expected:
            return f"chunk {at} has {chunk.size} of {expected} bytes"
        offsets.add(at)
        spans.append((begin, end))
        return None

    wrong = values.id.chunk_iter(check)
    spans.sort()
    if not wrong and any(end > following for (_, end), (following, _) in pairwise(spans)):
        wrong = "two chunks lie in the same bytes"
    return f"the index of {values.name} is damaged: {wrong}" if wrong else None


def _attributes(item: Any) -> str | None:
    for name in item.attrs:
        try:
            stored = item.attrs.get_id(name)
            if stored.get_storage_size() > MOST_ATTRIBUTE_BYTES:
                return f"attribute {name!r} has {stored.get_storage_size()} bytes"
            item.attrs[name]
        except MemoryError:
            raise
        except Exception:
            continue
    return None


def _limit_memory(path: str, allowed: int) -> None:
    try:
        import resource
    except ImportError:  # Windows has no such limits
        return
    if not os.path.exists("/proc/self/statm"):
        return
    with open("/proc/self/statm") as file:
        now = int(file.read().split()[0]) * resource.getpagesize()
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (now + allowed + MOST_COMPRESSED * os.path.getsize(path), most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _limit_time(seconds: float) -> None:
    """Limit the CPU time of this process to `seconds` from now, after which a signal ends it; 0 removes the limit."""
    import signal

    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_PROF, seconds)


if __name__ == "__main__":
    main()
