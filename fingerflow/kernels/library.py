"""Interface to the compiled library: loading, function calls and exceptions."""

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
from typing import Any, NoReturn

import numpy as np

from fingerflow.kernels.arrays import Shaped, address_of_numpy
from fingerflow.kernels.declarations import HEADER, Function, digest, read

_NO_MEMORY = 1  # error code NO_MEMORY of kernels/entry.h
_WHOLE = ("i", "q")  # codes of integers in `declarations`
_OF_ANY_SIGN = {"most", "piece"}  # integer arguments, of kernels for tests, that may be negative

_log = logging.getLogger(__name__)


class _ThreadState(threading.local):
    """State of one thread: whether kernels that the thread calls compute results, or only allocate them."""

    shapes_only = False


_here = _ThreadState()


class Entry:
    """Callable kernel of the compiled library; arguments are named as in interface.h, and None is a null address.

    Addresses are given as NumPy arrays or torch tensors on the CPU, whose shape and memory layout is not checked. Whole
    numbers are counts, sizes and choices: none is negative.
    """

    def __init__(self, name: str, function: Function, library: ctypes.CDLL) -> None:
        """Look up the function `name` in the library."""
        self._name, self._names = name, tuple(field.name for field in function.fields)
        self._in_order = operator.itemgetter(*self._names)
        self._fields = function.fields
        self._addresses = tuple(place for place, field in enumerate(function.fields) if field.code == "P")
        whole = [
            k for k, field in enumerate(function.fields) if field.code in _WHOLE and field.name not in _OF_ANY_SIGN
        ]
        # Repeat the indices, since an itemgetter with a single index returns no tuple.
        self._whole = operator.itemgetter(*whole, *whole) if whole else lambda values: (0,)
        self._pack = struct.Struct(function.format).pack
        self._enter: Any = library[f"enter_{name}"]
        self._enter.argtypes = (ctypes.c_char_p,)
        self._message = library.fingerflow_last_message

    def __call__(self, **given: Shaped | float | None) -> None:
        """Call the library function, without holding the global interpreter lock.

        Raises:
            TypeError: the number of arguments is wrong, or an argument is no number.
            ValueError: a tensor is on another device, or a number is out of range.
            KeyError: an argument is missing under its name.
            MemoryError: the kernel cannot allocate its memory.
            RuntimeError: any other exception of the kernel, with its name.
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
            elif isinstance(value, np.ndarray):  # same as `address`, without the cost of the call
                values[place] = address_of_numpy(value)
            elif value.is_cpu:
                values[place] = value.data_ptr()
            else:
                raise ValueError(
                    f"kernel {self._name}: {self._names[place]} is on {value.device}: give tensors on the CPU"
                )
        try:
            packed = self._pack(*values)
            fit = min(self._whole(values)) >= 0
        except (struct.error, OverflowError, TypeError):
            fit = False
        if not fit:
            self._refuse(values)
        outcome = self._enter(packed)
        if outcome:
            said = self._message().decode(errors="replace")
            if outcome == _NO_MEMORY:
                raise MemoryError(f"kernel {self._name}: no memory ({said}); give it smaller batches or fewer threads")
            raise RuntimeError(f"kernel {self._name} failed: {said}")

    def _refuse(self, values: list[Any]) -> NoReturn:
        """Raise the error for the first numeric argument that does not fit the declared type."""
        for (name, code), value in zip(self._fields, values, strict=True):
            said = f"kernel {self._name}: {name} is {value!r}: give "
            if code not in _WHOLE:
                if code != "P" and not _fits_format(code, value):
                    raise (ValueError if isinstance(value, int | float) else TypeError)(
                        f"{said}a number, not too large"
                    )
            elif not _fits_format(code, value) or (value < 0 and name not in _OF_ANY_SIGN):
                words = f"{said}a whole number from 0 to 2^{8 * struct.calcsize(code) - 1} - 1"
                raise (ValueError if hasattr(value, "__index__") else TypeError)(words)
        raise ValueError(f"kernel {self._name} cannot be called with {values}")


def _fits_format(code: str, value: Any) -> bool:
    """Return whether a value fits a format code of `struct`."""
    try:
        struct.pack(code, value)
    except (struct.error, OverflowError, TypeError):
        return False
    return True


def entry(name: str) -> Entry:
    """Return the callable of a kernel by function name, without the common prefix of the library.

    Raises:
        RuntimeError: the compiled kernels cannot be used.
    """
    library = _library()
    if library is None:
        raise RuntimeError("the compiled kernels do not serve here: build them with `pip install -e .`")
    return library[name]


@contextmanager
def shapes_only() -> Iterator[None]:
    """Return a context in which the kernels of this thread check arguments and allocate results but compute nothing, so
    that a compiler can trace shapes.
    """
    before, _here.shapes_only = _here.shapes_only, True
    try:
        yield
    finally:
        _here.shapes_only = before


def values_are_known() -> bool:
    """Return whether checks may read the values of arrays; within `shapes_only` values are not computed."""
    return not _here.shapes_only


def limit_instruction_set(most: int) -> int:
    """Limit the kernels to an instruction set (0 baseline, 1 AVX2, 2 AVX-512), for tests; return the set in use.

    -1 removes the limit.
    """
    taken = np.empty(1, np.int32)
    entry("limit_instruction_set")(most=most, taken=taken)
    return int(taken[0])


def inject_fault(fault: int, piece: int = -1, thread: int = 0) -> None:
    """Make a kernel fail, for tests, when a thread of the kind `thread` begins piece number `piece` of the parallel
    work (any piece if negative); `fault` is the kind of failure, 0 for normal operation.

    Faults are numbered as in kernels/parallel.h.
    """
    entry("inject_fault")(fault=fault, piece=piece, thread=thread)


def is_present() -> bool:
    """Return whether the compiled library is installed, built from the present sources and not switched off."""
    return _library() is not None


def threads() -> int:
    """Return the number of threads that kernels use: the setting of torch if this process has loaded torch.

    Otherwise that of `set_threads`, of `OMP_NUM_THREADS`, or of the processors available to this process.
    """
    of_torch = getattr(sys.modules.get("torch"), "get_num_threads", None)
    return _own_threads() if of_torch is None else of_torch()


def set_threads(count: int) -> None:
    """Set the number of threads of the kernels, and of torch if this process has loaded torch."""
    global _threads
    _threads = count
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(count)


_threads = 0  # number of threads of the kernels, 0 if not set


def _own_threads() -> int:
    return _threads or _lent_threads()


@functools.cache
def _lent_threads() -> int:
    asked = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0].strip()
    if asked.isdecimal() and int(asked):
        return int(asked)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _path() -> Path | None:
    """Return the path of the compiled library in the package, preferably the one built for this Python version.

    The library is no Python module, so one built for another version works as well.
    """
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
