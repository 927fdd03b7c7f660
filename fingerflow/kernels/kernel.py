"""Calls of compiled functions: arguments are checked, and results allocated, by their declarations."""

import ctypes
import functools
import os
import struct
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import CodeType
from typing import Any, NamedTuple, NoReturn

import numpy as np

from fingerflow.kernels.arrays import (
    DATA_OFFSET,
    KINDS,
    address,
    copied,
    empty,
    in_one_piece,
    limits_of,
    rows_in_one_piece,
)
from fingerflow.kernels.declarations import ArrayField, Function, NumberField

_NO_MEMORY = 1  # error code NO_MEMORY of kernels/entry.h
_PLAIN = {int, float, bool, type(None)}
_LAYOUTS = 256  # largest number of layouts of calls that are kept, of which a stream has a few
_address_at = ctypes.c_size_t.from_address
_NO_NAMES: dict[str, Any] = {"__builtins__": {}}  # besides the numbers of a function, for expressions of declarations


class _ThreadState(threading.local):
    """State of one thread: whether kernels that the thread calls compute results, or only allocate them."""

    shapes_only = False


_here = _ThreadState()


class _Layout(NamedTuple):
    """What follows from dtypes and shapes of the arrays, and from the whole numbers, of a call that was checked.

    Attributes:
        arguments: numbers in packing order, with sizes, strides and dtypes of the arrays; 0 for arrays.
        varying: position and name of each argument that is a float, and of each array that has an address.
        copied: names of the arrays that are copied.
        limits: name of each array of indices, name and value of the number below which they lie.
        like: name of an array that is a tensor, "" if none is.
        results: name, dtype, shape (None if it is not allocated) of each result, and whether it begins as zeros.
    """

    arguments: list[Any]
    varying: list[tuple[int, str]]
    copied: list[str]
    limits: list[tuple[str, str, int]]
    like: str
    results: list[tuple[str, str, tuple[Any, ...] | None, bool]]


# Kernels of about 20 us, in which a thread of a stream would wait longer for the interpreter's lock if it released it.
_SHORT = {"block_means", "covered", "frame_distances", "mean_response", "strip_differences"}


class Kernel:
    """Callable kernel of the compiled library; arguments are named as in its declaration.

    Arrays are NumPy arrays or torch tensors on the CPU, copied only if they are not contiguous; results are newly
    allocated, as tensors if any of the arrays is one. Sizes, strides and dtypes are taken from the arrays.
    """

    def __init__(self, name: str, function: Function, library: ctypes.CDLL) -> None:
        """Look up the function `name` in the library."""
        self._name, self.function = name, function
        arrays = function.arrays
        self._numbers = [field for field in function.fields if isinstance(field, NumberField)]
        # Sizes that may be 1 in place of another size are checked last, as that must be known.
        inputs = sorted(
            (array for array in arrays if array.role != "result"), key=lambda array: "|" in str(array.shape)
        )
        self._inputs = [(array, array.name, [_size(size) for size in array.shape]) for array in inputs]
        self._names = [array.name for array in arrays]
        self._places = {field.name: place for place, field in enumerate(function.fields)}
        self._conditions = [(number, compile(number.where, name, "eval")) for number in self._numbers if number.where]
        self._indices = [(array.name, array.below) for array in inputs if array.below]
        self._results = [array for array in arrays if array.role != "input"]
        self._shapes = [_shape(array.shape) for array in self._results]
        self._arguments = {array.name for array in inputs} | {number.name for number in self._numbers}
        self._defaults = dict.fromkeys(function.derived, 0)
        self._needed = {argument.name for argument in function.arguments}
        self._pack = struct.Struct(function.format).pack
        self._enter: Any = (ctypes.PyDLL(library._name) if name in _SHORT else library)[f"enter_{name}"]
        self._enter.argtypes = (ctypes.c_char_p,)
        self._message = library.fingerflow_last_message
        self._layouts = dict[tuple[Any, ...], _Layout]()

    def __call__(self, **values: Any) -> Any:
        """Call the library function and return its results in the order of the declaration: a tuple, or the only one.
        The global interpreter lock is released during the call, except for the kernels in `_SHORT`.

        Numbers that the shapes of arrays tell may be left out.

        Raises:
            TypeError: an argument is missing or unknown, an array has another dtype, or a number is none.
            ValueError: a tensor is on another device, a shape does not fit, or a number or an index is out of range.
            MemoryError: the kernel cannot allocate its memory.
            RuntimeError: any other exception of the kernel, with its name.
        """
        # Here, as a call of Python for each step would take as long as the step.
        key: Any = [*values]
        for value in values.values():
            kind = type(value)
            if kind is np.ndarray:
                key += value.dtype, value.shape, value.strides, value.flags.aligned
            elif kind in _PLAIN:
                key += (kind if kind is float else value,)
            else:
                key = ()  # layouts of tensors are not kept
                break
        key = tuple(key)
        layout = self._layouts.get(key)
        if layout is None:
            layout = self._layout(values)
            if key:
                if len(self._layouts) >= _LAYOUTS:
                    self._layouts.clear()
                self._layouts[key] = layout
        like = values[layout.like] if layout.like else None
        for name in layout.copied:
            values[name] = values[name].copy() if like is None else copied(values[name])
        for name, below, limit in () if _here.shapes_only else layout.limits:
            self._check_indices(name, values[name], below, limit)
        results = [None] * len(layout.results)
        for place, (name, dtype, shape, cleared) in enumerate(layout.results):
            if shape is not None:
                values[name] = np.empty(shape, dtype) if like is None else empty(like, dtype, shape)
                if cleared:
                    values[name][...] = 0
            if name in values:
                results[place] = values[name]
        if not _here.shapes_only:
            arguments = [*layout.arguments]
            for place, name in layout.varying:
                value = values[name]
                if DATA_OFFSET and type(value) is np.ndarray:
                    arguments[place] = _address_at(id(value) + DATA_OFFSET).value
                else:
                    arguments[place] = value if type(value) is float else address(value)
            if "threads" in self._places:  # as `threads()`, which would be one more call of Python
                torch = sys.modules.get("torch")
                arguments[-1] = (_threads or _lent_threads()) if torch is None else torch.get_num_threads()
            try:
                packed = self._pack(*arguments)
            except (struct.error, OverflowError, TypeError):
                for number in self._numbers:
                    value = arguments[self._places[number.name]]
                    try:
                        struct.pack(number.code, value)
                    except (struct.error, OverflowError, TypeError):
                        self._refuse_number(number, value)
                raise
            outcome = self._enter(packed)
            if outcome:
                message = self._message().decode(errors="replace")
                if outcome == _NO_MEMORY:
                    advice = "give it smaller batches or fewer threads"
                    raise MemoryError(f"kernel {self._name}: no memory ({message}); {advice}")
                raise RuntimeError(f"kernel {self._name} failed: {message}")
        return results[0] if len(results) == 1 else tuple(results)

    def _layout(self, values: dict[str, Any]) -> _Layout:
        """Check names, numbers, dtypes and shapes of the arguments, not array values; return the call's layout."""
        if not self._needed <= values.keys() <= self._arguments:
            raise TypeError(f"kernel {self._name} was called with {sorted(values)}: it has {sorted(self._arguments)}")
        numbers = values.copy()
        copies, like = self._checked_arrays(numbers)
        numbers = {**self._defaults, **numbers}
        for number in self._numbers:
            value = numbers[number.name]
            if number.least is not None and (
                not hasattr(value, "__index__")
                or not number.least <= value <= number.most
                or (number.step > 1 and (value - number.least) % number.step)
                or (number.among and value not in number.among)
            ):
                self._refuse_number(number, value)
        for number, condition in self._conditions:
            if not eval(condition, _NO_NAMES, numbers):
                raise ValueError(f"kernel {self._name}: {number.name} is {numbers[number.name]}: give {number.where}")
        results: list[tuple[str, str, tuple[Any, ...] | None, bool]] = []
        for field, sizes in zip(self._results, self._shapes, strict=True):
            shape = None
            dtype = ""
            if values.get(field.name) is None and (not field.needs or values[field.needs] is not None):
                dtype = field.dtypes[0] if field.dtypes else KINDS[values[field.like].dtype]
                if isinstance(sizes, CodeType):
                    shape = eval(sizes, _NO_NAMES, numbers)
                else:
                    shape = tuple([numbers.get(str(size), size) for size in sizes])  # a number is its own size
            results.append((field.name, dtype, shape, field.role == "updated"))
        known = {name for name in self._names if values.get(name) is not None}
        known |= {name for name, value in values.items() if type(value) is float}
        known |= {name for name, _, shape, _ in results if shape is not None}
        return _Layout(
            [0 if name in self._names else numbers[name] for name in self._places],
            [(place, name) for name, place in self._places.items() if name in known],
            copies,
            [(name, below, numbers[below]) for name, below in self._indices if name in known],
            like,
            results,
        )

    def _checked_arrays(self, values: dict[Any, Any]) -> tuple[list[str], str]:
        """Check the arrays among the arguments, and add their sizes, strides and codes of dtypes to the arguments.

        Return the names of those that a call copies, and of one of them that is a tensor, or "".
        """
        copies, like = list[str](), ""
        for field, name, sizes in self._inputs:
            array = values[name]
            if array is None and field.optional:
                continue
            dtype = getattr(array, "dtype", None)
            if KINDS[dtype] not in (field.dtypes or (KINDS[values[field.like].dtype],)):
                self._refuse_array(field, array, values, TypeError)
            if field.dtypes:
                values[f"{name}_kind"] = field.dtypes.index(KINDS[dtype])
            if array.ndim != len(sizes):
                self._refuse_array(field, array, values)
            for (letter, size), actual in zip(sizes, array.shape, strict=True):
                if size is None:
                    fits = values.setdefault(letter, actual) == actual
                else:
                    needed = eval(size, _NO_NAMES, values) if isinstance(size, CodeType) else values.get(size, size)
                    fits = actual == needed or (letter is not None and actual == 1)
                    if letter is not None:
                        values[letter] = actual
                if not fits:
                    self._refuse_array(field, array, values)
            whole = array
            if field.rows:
                whole = in_one_piece(array) if field.whole else array
                whole, values[f"{name}_stride"], values[f"{name}_row_stride"] = rows_in_one_piece(whole)
            elif field.role != "updated":
                whole = in_one_piece(array)
            if field.role == "updated" or whole is not array:
                copies.append(name)
            if not like and not isinstance(array, np.ndarray):
                like = name
        return copies, like

    def _refuse_array(
        self, field: ArrayField, array: Any, values: dict[str, Any], error: type[Exception] = ValueError
    ) -> NoReturn:
        """Raise the error for an array that does not fit its declaration."""
        actual = f"{KINDS[array.dtype]} {tuple(array.shape)}" if hasattr(array, "dtype") else type(array).__name__
        dtypes = " or ".join(field.dtypes) or f"the dtype of {field.like}"
        known = ", ".join(f"{name} {value}" for name, value in values.items() if name in " ".join(field.shape).split())
        shape = f"({', '.join(field.shape)})" + (f" with {known}" if known else "")
        raise error(f"kernel {self._name}: {field.name} is {actual}: {dtypes} {shape} is needed")

    def _refuse_number(self, number: NumberField, value: Any) -> NoReturn:
        """Raise the error for a number that does not fit its declaration."""
        words = "a number, not too large"
        if number.least is not None:
            most = f"2^{number.most.bit_length()} - 1" if number.most >= (1 << 31) - 1 else number.most
            words = f"a whole number from {number.least} to {most}"
            words += f" in steps of {number.step}" if number.step > 1 else ""
            words = f"one of {number.among}" if number.among else words
        whole = hasattr(value, "__index__") or (number.least is None and isinstance(value, float))
        raise (ValueError if whole else TypeError)(f"kernel {self._name}: {number.name} is {value!r}: give {words}")

    def _check_indices(self, name: str, array: Any, below: str, limit: int) -> None:
        """Raise ValueError unless the values of an array of indices lie from 0 to the declared limit."""
        if 0 not in array.shape:
            lowest, highest = limits_of(array)
            if not 0 <= lowest <= highest < limit:
                raise ValueError(
                    f"kernel {self._name}: {name} goes from {lowest} to {highest}: it must lie from 0 to {below} - 1, "
                    f"which is {limit - 1}"
                )


def _size(text: str) -> tuple[str | None, int | str | CodeType | None]:
    """Return the name that a declared size gives to the size of an axis, if any, and the size that it must have."""
    letter, _, size = text.rpartition("|")
    if size.isidentifier():
        return (letter, size) if letter else (size, None)
    return letter or None, int(size) if size.isdecimal() else compile(size, text, "eval")


def _shape(sizes: Sequence[str]) -> list[int | str] | CodeType:
    """Return the sizes of the axes of a result, as numbers and names, or an expression that gives them."""
    if all(size.isidentifier() or size.isdecimal() for size in sizes):
        return [int(size) if size.isdecimal() else size for size in sizes]
    return compile(f"({', '.join(sizes)},)", "shape", "eval")


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
    """Return whether the values of arrays may be read; within `shapes_only` they are not computed."""
    return not _here.shapes_only


def threads() -> int:
    """Return the number of threads that kernels use: the setting of torch if this process has loaded torch.

    Otherwise that of `set_threads`, of `OMP_NUM_THREADS`, or of the processors available to this process.
    """
    torch = sys.modules.get("torch")
    return (_threads or _lent_threads()) if torch is None else torch.get_num_threads()


def set_threads(count: int) -> None:
    """Set the number of threads of the kernels, and of torch if this process has loaded torch."""
    global _threads
    _threads = count
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(count)


_threads = 0  # number of threads of the kernels, 0 if not set


@functools.cache
def _lent_threads() -> int:
    requested = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0].strip()
    return int(requested) if requested.isdecimal() and int(requested) else cores()


def cores() -> int:
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
