"""The library of compiled kernels: whether it serves, how its functions are called, what becomes of what they throw."""

import ctypes
import functools
import importlib.util
import logging
import operator
import os
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import torch
from torch import Tensor

from fingerflow.kernels.declarations import HEADER, Function, digest, read

CPU = torch.device("cpu")  # of all results, whatever torch's default device is
_NO_MEMORY = 1  # of kernels/entry.h

F = TypeVar("F", bound=Callable[..., Any])

_log = logging.getLogger(__name__)


def constant_to_compiler(function: F) -> F:
    """Marks a function whose result torch's compiler takes as it is, without tracing it.

    As `torch.compiler.assume_constant_result` does, which loads the compiler for it: a quarter of what starting takes.
    """
    function._dynamo_marked_constant = True  # type: ignore[attr-defined]
    return function


class _Here(threading.local):
    """What holds for this thread."""

    shapes_only = False


_here = _Here()


def serve(*tensors: Tensor | None) -> bool:
    """Whether the compiled kernels may take these tensors here and now.

    They do while torch compiles, as ops of torch's own (`torch_op`), not while it traces or exports the portable form.
    """
    if torch.compiler.is_compiling():
        if torch.compiler.is_exporting() or not _is_present():
            return False
    elif (
        _library() is None
        or torch.jit.is_tracing()  # type: ignore[attr-defined, no-untyped-call]
        or torch._C._len_torch_dispatch_stack() > 0  # somebody records or changes what the ops do
        or torch._C._are_functorch_transforms_active()
    ):
        return False
    for tensor in tensors:  # noqa: SIM110  a generator takes half a microsecond more
        if tensor is not None and not _is_plain(tensor):
            return False
    return True


class Entry:
    """A function of interface.h: arguments go by their names there, a tensor for an address, None for no address."""

    def __init__(self, name: str, function: Function, library: ctypes.CDLL) -> None:
        """Finds `name` in the library."""
        self._name, self._names = name, tuple(field.name for field in function.fields)
        self._in_order = operator.itemgetter(*self._names)
        self._addresses = tuple(place for place, field in enumerate(function.fields) if field.code == "P")
        self._pack = struct.Struct(function.format).pack
        self._enter: Any = library[f"enter_{name}"]
        self._enter.argtypes = (ctypes.c_char_p,)
        self._message = library.fingerflow_last_message

    def __call__(self, **given: Tensor | int | float | None) -> None:
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
            values[place] = 0 if value is None else value if type(value) is int else value.data_ptr()
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
    """Whether checks may look into tensors: not within `shapes_only`."""
    return not _here.shapes_only


def limit_instruction_set(most: int) -> int:
    """For tests: use no wider set than 0 baseline, 1 AVX2, 2 AVX-512, -1 what there is; returns the one taken."""
    taken = torch.empty(1, dtype=torch.int32, device=CPU)
    entry("limit_instruction_set")(most=most, taken=taken)
    return int(taken)


def inject_fault(fault: int, piece: int = -1, thread: int = 0) -> None:
    """For tests: pieces of work fail from now on, as kernels/parallel.h numbers faults and threads; 0 ends it."""
    entry("inject_fault")(fault=fault, piece=piece, thread=thread)


@constant_to_compiler
def _is_present() -> bool:
    return _library() is not None


@functools.cache
def _library() -> dict[str, Entry] | None:
    if os.environ.get("FINGERFLOW_KERNELS", "1") == "0":
        return None
    found = importlib.util.find_spec("fingerflow._kernels")
    if found is None or found.origin is None:
        _log.info("compiled kernels were not built (no C++ compiler at install time?): portable ops serve, more slowly")
        return None
    library = ctypes.CDLL(found.origin)
    header = HEADER.read_text(encoding="utf-8")
    for text in ("fingerflow_digest", "fingerflow_last_message"):
        if hasattr(library, text):
            getattr(library, text).restype = ctypes.c_char_p
    if not hasattr(library, "fingerflow_digest") or library.fingerflow_digest() != digest(header).encode():
        _log.info("%s was built from other sources: install again; portable ops serve, more slowly", found.origin)
        return None
    return {name: Entry(name, function, library) for name, function in read(header).items()}


def _is_plain(tensor: Tensor) -> bool:
    return (
        type(tensor) is Tensor
        and tensor.is_cpu
        and tensor.layout == torch.strided
        and not (tensor.requires_grad and torch.is_grad_enabled())
    )
