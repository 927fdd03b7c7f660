"""The library of compiled kernels: whether it serves, how its functions are called, what becomes of what they throw."""

import ctypes
import functools
import logging
import operator
import os
import struct
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Any

import numpy as np

from fingerflow.kernels.arrays import Shaped, address_of_numpy
from fingerflow.kernels.declarations import HEADER, Function, digest, read

_NO_MEMORY = 1  # of kernels/entry.h

_log = logging.getLogger(__name__)


class _Here(threading.local):
    """What holds for this thread."""

    shapes_only = False


_here = _Here()


class Entry:
    """A function of interface.h: arguments go by their names there, None for no address.

    NumPy arrays and tensors of torch are given for addresses: nothing is asked of how their numbers lie in memory.
    """

    def __init__(self, name: str, function: Function, library: ctypes.CDLL) -> None:
        """Finds `name` in the library."""
        self._name, self._names = name, tuple(field.name for field in function.fields)
        self._in_order = operator.itemgetter(*self._names)
        self._addresses = tuple(place for place, field in enumerate(function.fields) if field.code == "P")
        self._pack = struct.Struct(function.format).pack
        self._enter: Any = library[f"enter_{name}"]
        self._enter.argtypes = (ctypes.c_char_p,)
        self._message = library.fingerflow_last_message

    def __call__(self, **given: Shaped | float | None) -> None:
        """Calls it, without the lock of Python.

        Raises:
            TypeError: arguments of other names than the function has.
            MemoryError: there is no memory for what it works on.
            RuntimeError: anything else that it throws, with its name.
        """
        if _here.shapes_only:
            return
        if len(given) != len(self._names):
            raise TypeError(f"kernel {self._name} was called with {sorted(given)}: it has {sorted(self._names)}")
        values: list[Any] = list(self._in_order(given))
        for place in self._addresses:
            value = values[place]
            if value is None:
                values[place] = 0
            else:  # what `address` does, for whose calls there is no time
                values[place] = address_of_numpy(value) if isinstance(value, np.ndarray) else value.data_ptr()
        outcome = self._enter(self._pack(*values))
        if outcome:
            said = self._message().decode(errors="replace")
            if outcome == _NO_MEMORY:
                raise MemoryError(f"kernel {self._name}: no memory ({said}); give it smaller batches or fewer threads")
            raise RuntimeError(f"kernel {self._name} failed: {said}")


def entry(name: str) -> Entry:
    """The function of this name, without its prefix.

    Raises:
        RuntimeError: the compiled kernels do not serve here.
    """
    library = _library()
    if library is None:
        raise RuntimeError("the compiled kernels do not serve here: build them with `pip install -e .`")
    return library[name]


@contextmanager
def shapes_only() -> Iterator[None]:
    """Within it, this thread's functions of kernels check and make their results, but compute nothing: for tracing."""
    before, _here.shapes_only = _here.shapes_only, True
    try:
        yield
    finally:
        _here.shapes_only = before


def values_are_known() -> bool:
    """Whether checks may look into arrays: not within `shapes_only`."""
    return not _here.shapes_only


def limit_instruction_set(most: int) -> int:
    """For tests: use no wider set than 0 baseline, 1 AVX2, 2 AVX-512, -1 what there is; returns the one taken."""
    taken = np.empty(1, np.int32)
    entry("limit_instruction_set")(most=most, taken=taken)
    return int(taken[0])


def inject_fault(fault: int, piece: int = -1, thread: int = 0) -> None:
    """For tests: pieces of work fail from now on, as kernels/parallel.h numbers faults and threads; 0 ends it."""
    entry("inject_fault")(fault=fault, piece=piece, thread=thread)


def is_present() -> bool:
    """Whether the library is here, is that of these sources, and is not turned off."""
    return _library() is not None


def threads() -> int:
    """Return how many threads the kernels use: as many as torch where this process has loaded it.

    Else what `set_threads` was given, `OMP_NUM_THREADS` says, or the system lends.
    """
    of_torch = getattr(sys.modules.get("torch"), "get_num_threads", None)
    return _own_threads() if of_torch is None else of_torch()


def set_threads(count: int) -> None:
    """Set how many threads the kernels use, and torch with them where this process has loaded it."""
    global _threads
    _threads = count
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(count)


_threads = 0  # as many as there are


def _own_threads() -> int:
    return _threads or _lent_threads()


@functools.cache
def _lent_threads() -> int:
    asked = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0].strip()
    if asked.isdecimal() and int(asked):
        return int(asked)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _path() -> Path | None:
    """The library beside this folder: it is no module, so that one built for another version of Python does as well."""
    folder = HEADER.parent.parent
    own = (folder / f"_kernels{suffix}" for suffix in EXTENSION_SUFFIXES)
    others = (path for path in sorted(folder.glob("_kernels.*")) if path.suffix in (".so", ".pyd"))
    return next((path for path in (*own, *others) if path.is_file()), None)


@functools.cache
def _library() -> dict[str, Entry] | None:
    if os.environ.get("FINGERFLOW_KERNELS", "1") == "0":
        return None
    path = _path()
    if path is None:
        _log.info("compiled kernels were not built (no C++ compiler at install time?): portable ops serve, more slowly")
        return None
    library = ctypes.CDLL(str(path))
    header = HEADER.read_text(encoding="utf-8")
    for text in ("fingerflow_digest", "fingerflow_last_message"):
        if hasattr(library, text):
            getattr(library, text).restype = ctypes.c_char_p
    if not hasattr(library, "fingerflow_digest") or library.fingerflow_digest() != digest(header).encode():
        _log.info("%s was built from other sources: install again; portable ops serve, more slowly", path)
        return None
    return {name: Entry(name, function, library) for name, function in read(header).items()}
