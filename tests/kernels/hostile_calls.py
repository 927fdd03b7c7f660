"""Calls of every function of kernels with wrong arguments, each in a child process that may crash.

The functions are those of `kernel_calls` and those that ops call, so that every entry of interface.h is reached. Arrays
end where memory ends: the page behind them cannot be read. Each call is made twice, with other bytes before its arrays
and in the memory of its results, so that results that depend on such bytes differ.
"""

import ctypes
import inspect
import mmap
import os
import pickle
import resource
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any, BinaryIO, NamedTuple, NoReturn
from unittest.mock import patch

import numpy as np
import torch
from torch import Tensor

from fingerflow.kernels import arrays, library
from fingerflow.kernels import tensors as kernels
from tests.embedded import tensors_of
from tests.kernels.kernel_calls import Call, calls, in_tensors, kernel_calls, reached

SECONDS, BYTES = 60, 8 << 30  # limits of a call
NO_ACCESS = 0  # PROT_NONE of sys/mman.h
REFUSED, GIVEN, OTHER, WILD = "refused", "a result", "another result", "wild memory"
REFUSALS = (TypeError, ValueError, MemoryError, RuntimeError)  # torch's: sparse tensors, memory
ROUNDS = ("rounds", "cycles", "sweeps", "coarsest")  # of 32 bits: a kernel works for long if asked for so many
ENTRIES_FOR_TESTS = {"limit_instruction_set", "inject_fault"}


class Hostile(NamedTuple):
    """A call of a function, the change of one of its arguments, and whether the change leaves the result the same."""

    function: str
    change: str
    argument: str
    call: Call
    same: bool


def plain_calls() -> dict[str, Call]:
    """Return one correct call of every function of kernels that takes arrays, by name."""
    found = {name: one for name, one in kernel_calls().items() if one.function.__name__ != "<lambda>"}
    known = {one.function.__name__ for one in found.values()}

    def noted(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def note(*given: Any, **settings: Any) -> Any:
            if name not in known and name not in found:
                kept = [one.clone() if isinstance(one, Tensor) else one for one in given]
                found[name] = Call(function, tuple(kept), settings)
            return function(*given, **settings)

        return note

    with ExitStack() as patches, torch.no_grad():
        for name, function in list(vars(kernels).items()):
            if getattr(function, "__module__", "").startswith("fingerflow.kernels.") and hasattr(
                function, "__wrapped__"
            ):
                patches.enter_context(patch.object(kernels, name, noted(name, function)))
        for call in calls().values():
            call()
    return found


def missing_entries(plain: dict[str, Call]) -> set[str]:
    """Return the entries of the library that no call reaches."""
    seen = set().union(*(reached(one) for one in plain.values()))
    return set(library._library() or ()) - seen - ENTRIES_FOR_TESTS


def of_array(value: Any) -> Iterator[tuple[str, Any, bool]]:
    """Yield what may be given in place of an array: a name, the value, and whether the result stays the same."""
    tensor = isinstance(value, Tensor)
    like = torch if tensor else np
    if value.ndim:
        yield "empty", value[:0], False
        yield "one less", value[:-1], False
        yield "no columns", value[..., :0], False
        yield "one column less", value[..., :-1], False
        yield "one axis less", value[0], False
        yield "twice", (torch.cat if tensor else np.concatenate)((value, value)), False
        spread = np.repeat(value, 2, -1) if not tensor else value.repeat_interleave(2, -1)
        yield "strided", spread[..., ::2], True
        yield "transposed", value.mT if tensor and value.ndim > 1 else np.swapaxes(value, 0, -1), False
    yield "no axes", value.reshape(-1)[:1].reshape(()), False
    yield "all axes", value.reshape((1,) * 3 + tuple(value.shape)), False
    for kind in ("float64", "float32", "int64", "int16", "bool", "complex64"):
        if str(value.dtype).removeprefix("torch.") != kind:
            yield kind, value.to(getattr(torch, kind)) if tensor else value.astype(kind), False
    if tensor:
        yield "meta", value.to("meta"), False
        yield "sparse", value.to_sparse(), False
        if value.is_floating_point():
            yield "negated view", torch._neg_view(-value), True
    else:
        yield "other byte order", value.astype(value.dtype.newbyteorder()), False
    floating = "float" in str(value.dtype)
    for odd in (float("nan"), float("inf"), 3e38, -3e38) if floating else (-1, 1 << 40, -(1 << 62)):
        if floating or "int64" in str(value.dtype):
            yield f"all {odd:g}", like.full_like(value, odd), False


def of_number(value: Any) -> Iterator[tuple[str, Any, bool]]:
    for odd in (-1, 0, -(1 << 31), (1 << 31) - 1, 1 << 31, 1 << 40, (1 << 63) - 1, 1 << 63, 1 << 70):
        yield f"{odd:g}", odd, False
    for odd in (float("nan"), float("inf"), 1e300, 1.5, "1"):
        yield f"{odd!r}", odd, False


def changes_of(value: Any) -> Iterator[tuple[str, Any, bool]]:
    if isinstance(value, Tensor | np.ndarray):
        yield from of_array(value)
    elif isinstance(value, int | float):
        yield from of_number(value)
    elif isinstance(value, list | tuple):
        if not hasattr(value, "_fields"):
            yield "none", (), False
            yield "one less", value[:-1], False
            yield "one more", (*value, *value[-1:]), False
        for place, one in enumerate(value):
            for name, odd, same in changes_of(one):
                changed = [*value[:place], odd, *value[place + 1 :]]
                yield f"[{place}] {name}", type(value)(*changed) if hasattr(value, "_fields") else changed, same


def hostile_calls(plain: dict[str, Call]) -> Iterator[Hostile]:
    for function, call in plain.items():
        given = inspect.signature(call.function).bind(*call.arguments, **call.settings).arguments
        for argument, value in given.items():
            for change, odd, same in changes_of(value):
                if argument in ROUNDS and odd == (1 << 31) - 1:
                    continue
                yield Hostile(function, change, argument, Call(call.function, (), {**given, argument: odd}), same)
        for change in ("empty", "no columns", "meta", "one less"):
            every = {name: _changed(one, change) for name, one in given.items()}
            yield Hostile(function, change, "all", Call(call.function, (), every), False)


def _changed(value: Any, change: str) -> Any:
    if isinstance(value, list | tuple):
        parts = [_changed(one, change) for one in value]
        return type(value)(*parts) if hasattr(value, "_fields") else type(value)(parts)
    if not isinstance(value, Tensor | np.ndarray):
        return value
    return next((odd for name, odd, _ in of_array(value) if name == change), value)


def at_the_end_of_memory(value: Any, filler: int) -> Any:
    """Return the same array in memory whose next page cannot be read, after bytes of `filler`; strides stay."""
    if isinstance(value, list | tuple):
        parts = [at_the_end_of_memory(one, filler) for one in value]
        return type(value)(*parts) if hasattr(value, "_fields") else type(value)(parts)
    if isinstance(value, Tensor):
        plain = value.device.type == "cpu" and value.layout == torch.strided and value.is_contiguous()
        if not plain or value.is_neg() or value.dtype not in _NUMPY:
            return value
        return torch.from_numpy(at_the_end_of_memory(value.numpy(), filler))
    if not isinstance(value, np.ndarray) or not value.flags.c_contiguous:
        return value
    page, size = mmap.PAGESIZE, value.nbytes
    whole = -(-max(size, 1) // page) * page
    memory = mmap.mmap(-1, whole + page)
    start = ctypes.addressof(ctypes.c_char.from_buffer(memory))
    ctypes.memset(start, filler, whole)
    ctypes.CDLL(None).mprotect(ctypes.c_void_p(start + whole), page, NO_ACCESS)
    placed = np.frombuffer(memory, value.dtype, value.size, whole - size).reshape(value.shape)
    placed[...] = value
    return placed


_NUMPY = {getattr(torch, name) for name in ("bool", "uint8", "int16", "uint16", "int32", "int64", "float32", "float64")}


def called(call: Call, filler: int) -> Any:
    """Return the result of a call whose results lie in memory of `filler` bytes."""
    plain_empty = arrays.empty

    def filled(*given: Any) -> Any:
        made = plain_empty(*given)
        if isinstance(made, Tensor):
            if made.device.type == "cpu":
                made.view(torch.uint8).fill_(filler) if made.ndim else None
        else:
            made.view(np.uint8)[...] = filler
        return made

    named = inspect.signature(call.function).bind(*call.arguments, **call.settings).arguments
    given = {name: at_the_end_of_memory(one, filler) for name, one in named.items()}
    with ExitStack() as patches:
        for module in _modules():
            patches.enter_context(patch.object(module, "empty", filled))
        return in_tensors(call.function(**given))


def _modules() -> list[Any]:
    return [
        module
        for name, module in sys.modules.items()
        if name.startswith("fingerflow.kernels.") and getattr(module, "empty", None) is arrays.empty
    ]


def outcome_in_this_process(call: Call, plain: Call | None) -> tuple[str, str]:
    """Return the outcome of a call in a word and a sentence; its result must be that of `plain`, if given."""
    right = None if plain is None else called(plain, 0)
    try:
        results = [called(call, filler) for filler in (0, 0xFF)]
    except REFUSALS as error:
        return (REFUSED if str(error) else type(error).__name__), f"{type(error).__name__}: {error}"
    except Exception as error:
        return type(error).__name__, str(error)
    one, other = (list(tensors_of(result)) for result in results)
    if not all(_same(*pair) for pair in zip(one, other, strict=True)):
        return WILD, "it depends on memory beyond the arrays, or is not written"
    if right is not None and not all(_same(*pair) for pair in zip(one, tensors_of(right), strict=True)):
        return OTHER, "than for the same numbers in one piece"
    return GIVEN, ""


def _same(one: Tensor, other: Tensor) -> bool:
    return one.shape == other.shape and torch.equal(one.nan_to_num(7.0), other.nan_to_num(7.0))


def outcomes(hostile: list[Hostile], plain: Call) -> Iterator[tuple[Hostile, str, str]]:
    """Yield each call with its outcome in words, or the name of the signal that ended its process.

    The calls are made in a forked child, one after the other; if it ends early, another child continues with the next
    call.
    """
    left = hostile
    while left:
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            _in_a_child(left, plain, writing)
        os.close(writing)
        with os.fdopen(reading, "rb") as pipe:
            told = list(_loaded(pipe))
        _, status = os.waitpid(child, 0)
        for one, (word, said) in zip(left, told, strict=False):
            yield one, word, said
        left = left[len(told) :]
        if left:
            first, *left = left
            name = signal.Signals(os.WTERMSIG(status)).name if os.WIFSIGNALED(status) else f"exit {status}"
            yield first, name, "the process ended"


def _in_a_child(hostile: list[Hostile], plain: Call, writing: int) -> NoReturn:
    resource.setrlimit(resource.RLIMIT_AS, (BYTES, BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        with os.fdopen(writing, "wb", buffering=0) as pipe, torch.no_grad():
            for one in hostile:
                signal.alarm(SECONDS)
                word, said = outcome_in_this_process(one.call, plain if one.same else None)
                pipe.write(pickle.dumps((word, said[:500])))
    finally:
        os._exit(0)


def _loaded(pipe: BinaryIO) -> Iterator[tuple[str, str]]:
    while True:
        try:
            yield pickle.load(pipe)
        except EOFError:
            return
