"""Traversal of files in a child process, because libraries crash, loop or exhaust memory on damaged ones.

Run as a script, it reads a line of JSON a file, with path and kind, and answers in a line each. It performs the same
operations as the readers on everything that they may access. Exceptions are ignored, because the reader gets the same
ones. A signal or a limit ends only this process.
"""

import base64
import importlib
import io
import json
import os
import sys
from collections.abc import Callable
from typing import Any

CPU_SECONDS = 10.0  # CPU time for one file; a thousand objects take 0.1 s
MEMORY_BYTES = 1 << 27  # in addition to the libraries and to the unpacked content of the file
VIDEO_BYTES = 3 << 28  # replaces MEMORY_BYTES for videos: decoders keep frames
MOST_COMPRESSED = 1032  # as in `schema.claimed_sizes`, which this script does not import
MOST_OBJECTS = 100_000
MOST_ATTRIBUTE_BYTES = 1 << 26


def main() -> None:
    """Traverse files named on the standard input, one a line, and print an answer for each, until the input ends."""
    print(json.dumps("ready"), flush=True)
    for line in sys.stdin:
        path, kind = json.loads(line)
        through, libraries = READERS[kind]
        for library in libraries:
            importlib.import_module(library)  # before the limit is set: their memory depends on the number of CPUs
        print(json.dumps(_walk(path, through)), flush=True)


def _walk(path: str, through: Callable[[str], Any]) -> Any:
    """Run `through` on a file with limits of time and memory; return what is wrong, "" if nothing, or content."""
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
    """Traverse objects, attributes and chunk index of an HDF5 file, without values; return what is wrong, or ""."""
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
                item.id.get_num_chunks()
        return wrong

    with h5py.File(path, "r") as file:
        return _attributes(file) or file.visititems(visit) or ""


def through_matlab(path: str) -> str | dict[str, Any]:
    """Return the content of a MATLAB file in JSON types (:func:`as_json`), or a text that says what is wrong with it.

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
    """Return the content of a MATLAB file by name; structs are mappings."""
    from pymatreader import read_mat

    return read_mat(path)


def as_json(value: Any) -> Any:
    """Convert values to JSON types: mappings, texts, arrays of numbers as {".npy": base64}, None for all else."""
    import numpy as np

    if isinstance(value, dict):
        return {str(name): as_json(one) for name, one in value.items()}
    if isinstance(value, str):
        return value
    try:
        numbers = np.asarray(value)
    except ValueError:  # cells with vectors of different lengths
        return None
    if numbers.dtype.kind not in "iuf":
        return None
    data = io.BytesIO()
    np.save(data, numbers, allow_pickle=False)
    return {".npy": base64.b64encode(data.getvalue()).decode("ascii")}


def through_tdms(path: str) -> str:
    """Traverse the segments of a TDMS file and their metadata, without values; return "" if that succeeds."""
    from nptdms import TdmsFile

    with TdmsFile.open(path):
        return ""


def through_video(path: str) -> str:
    """Open a video and let FFmpeg read its header, index and first frames; return "" if that succeeds."""
    import av

    with av.open(path, metadata_errors="replace"):
        return ""


READERS: dict[str, tuple[Callable[[str], Any], tuple[str, ...]]] = {
    "hdf5": (through_hdf5, ("h5py",)),
    "MATLAB": (through_matlab, ("h5py", "scipy.io", "pymatreader")),
    "TDMS": (through_tdms, ("nptdms",)),
    "video": (through_video, ("av",)),
}


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
    """Limit the CPU time of the process from now on; a signal ends it after `seconds`, and 0 removes the limit."""
    import signal

    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_PROF, seconds)


if __name__ == "__main__":
    main()
