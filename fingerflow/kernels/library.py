"""Compiled library of kernels: where it lies, whether it serves, and calls of its functions by name."""

import ctypes
import functools
import logging
import os
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

from fingerflow.kernels.declarations import Function, digest, interface, read
from fingerflow.kernels.kernel import Kernel

_log = logging.getLogger(__name__)
_PACKAGE = Path(__file__).resolve().parents[1]
_SOURCES = _PACKAGE.parent / "kernels"  # where the package is not installed but lies beside them


@functools.cache
def compiled(name: str) -> Kernel:
    """Return a kernel by function name, without the common prefix of the library; see `Kernel` for its calls.

    Raises:
        RuntimeError: the compiled kernels cannot be used.
    """
    library = _library()
    if library is None:
        raise RuntimeError("the compiled kernels do not serve here: build them with `pip install -e .`")
    return library[name]


def limit_instruction_set(most: int) -> int:
    """Limit the kernels to an instruction set (0 baseline, 1 AVX2, 2 AVX-512), for tests; return the set in use.

    -1 removes the limit.
    """
    return int(compiled("limit_instruction_set")(most=most)[0])


def inject_fault(fault: int, piece: int = -1, thread: int = 0) -> None:
    """Make a kernel fail, for tests, when a thread of the kind `thread` begins piece number `piece` of the parallel
    work (any piece if negative); `fault` is the kind of failure, 0 for normal operation.

    Faults are numbered as in kernels/parallel.h.
    """
    compiled("inject_fault")(fault=fault, piece=piece, thread=thread)


def declared() -> dict[str, Function]:
    """Return the functions of the compiled library by name; none where it does not serve."""
    return {name: kernel.function for name, kernel in (_library() or {}).items()}


@functools.cache  # whose calls are none of Python
def is_present() -> bool:
    """Return whether the compiled library is installed, built from the present sources and not switched off."""
    return _library() is not None


def _path() -> Path | None:
    """Return the path of the compiled library in the package, preferably the one built for this Python version.

    The library is no Python module, so one built for another version works as well.
    """
    own = (_PACKAGE / f"_kernels{suffix}" for suffix in EXTENSION_SUFFIXES)
    others = (path for path in sorted(_PACKAGE.glob("_kernels.*")) if path.suffix in (".so", ".pyd"))
    return next((path for path in (*own, *others) if path.is_file()), None)


@functools.cache
def _library() -> dict[str, Kernel] | None:
    if os.environ.get("FINGERFLOW_KERNELS", "1") == "0":
        return None
    path = _path()
    if path is None:
        _log.info("compiled kernels were not built (no C++ compiler at install time?): portable ops serve, more slowly")
        return None
    library = ctypes.CDLL(str(path))
    if hasattr(library, "fingerflow_interface"):
        for function in (library.fingerflow_digest, library.fingerflow_interface, library.fingerflow_last_message):
            function.restype = ctypes.c_char_p
        declarations = library.fingerflow_interface().decode()
        sources = interface(_SOURCES) if (_SOURCES / "interface.h").is_file() else declarations
        if library.fingerflow_digest().strip() == digest(sources).encode():
            return {name: Kernel(name, function, library) for name, function in read(declarations).items()}
    _log.info("%s was built from other sources: install again; portable ops serve, more slowly", path)
    return None
