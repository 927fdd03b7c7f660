"""Goes through HDF5 files in a process of its own: the library can crash, or turn in circles, in a damaged one.

Run as a script, with one path as JSON a line of its input; it answers a line a file. It does with a file what readers
will do, and looks at everything that they may look at. What merely raises an exception is no matter: the reader gets
the same exception. What ends this process, by a signal or by its limits, ends no other.
"""

import json
import sys
from typing import Any

import h5py

CPU_SECONDS = 10.0  # for one file; a thousand objects take 0.1 s
MEMORY_BYTES = 1 << 30  # besides the libraries
MOST_OBJECTS = 100_000
MOST_ATTRIBUTE_BYTES = 1 << 26


def main() -> None:
    """Answers until the input ends."""
    _limit_memory()
    print(json.dumps("ready"), flush=True)
    for line in sys.stdin:
        _limit_time(CPU_SECONDS)
        answer = walk(json.loads(line))
        _limit_time(0.0)
        print(json.dumps(answer), flush=True)


def walk(path: str) -> str:
    """What is wrong with a file, "" for nothing: objects, attributes and the index of chunks, but no values."""
    count = 0

    def visit(_: str, item: Any) -> str | None:
        nonlocal count
        count += 1
        if count > MOST_OBJECTS:
            return f"it has more than {MOST_OBJECTS} objects"
        return _attributes(item) or _storage(item)

    try:
        with h5py.File(path, "r") as file:
            return _attributes(file) or file.visititems(visit) or ""
    except MemoryError:
        return "its header asks for more memory than a file of its size can need"
    except Exception:
        return ""


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


def _storage(item: Any) -> str | None:
    if isinstance(item, h5py.Dataset):
        _ = item.shape, item.dtype, item.chunks, item.compression, item.fillvalue, item.is_virtual, item.external
        if item.chunks is not None:
            item.id.get_num_chunks()
    return None


def _limit_memory() -> None:
    try:
        import resource
    except ImportError:  # on Windows, which has no such limits
        return
    with open("/proc/self/statm") as file:
        size = int(file.read().split()[0]) * resource.getpagesize() + MEMORY_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (size, size))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _limit_time(seconds: float) -> None:
    """Of the processor's time: by a signal that ends the process, wherever it is."""
    import signal

    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_PROF, seconds)


if __name__ == "__main__":
    main()
