"""Refuses every request for memory of every kernel, one after the other, and says what became of it: a line a kernel.

LD_PRELOAD=<failing_new.cpp as a library> python -m tests.kernels.short_of_memory

Each trial is a forked child, whose pool of threads is new, as are the workspaces of its threads: nothing that an
earlier call has left is there. In the child the request is refused, the op has to raise MemoryError, and to give what
it gives otherwise when it is called once more. Where the request was one for a thread of the pool, fewer threads do the
work, and the op gives what it gives otherwise at once.
"""

import ctypes
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import torch

from fingerflow.kernels import library
from tests.embedded import CASES, tensors_of
from tests.kernels.kernel_calls import entered, kernel_calls, reached

THREADS = 3
FIRST = 16  # requests that are refused one by one; behind them every fourth more than the last
RIGHT, FEWER_THREADS, NOT_REFUSED, OTHER_EXCEPTION, OTHER_RESULT = range(5)
WORDS = ("MemoryError", "fewer threads", "all granted", "another exception", "another result")
# They work on what they are given, and ask for no memory.
FOR_TESTS = {"limit_instruction_set", "inject_fault"}


def calls() -> dict[str, Callable[[], Any]]:
    """What reaches every kernel, by itself and through the ops."""
    of_ops: dict[str, Callable[[], Any]] = {name: partial(case.call, *case.inputs) for name, case in CASES.items()}
    return kernel_calls() | of_ops


def same(one: Any, other: Any) -> bool:
    pairs = zip(tensors_of(one), tensors_of(other), strict=True)
    return all(torch.allclose(a.double(), b.double(), rtol=0, atol=0, equal_nan=True) for a, b in pairs)


def tried(call: Callable[[], Any], right: Any, wanted: str, number: int, hooks: ctypes.CDLL) -> int:
    """What became of a call of the op whose kernel `wanted` is refused a request, in a thread that is new."""
    refused = 0

    def refusing(name: str, enter: Callable[[], None]) -> None:
        nonlocal refused
        if name != wanted or refused:
            return enter()
        hooks.refuse_request(number)
        try:
            enter()
        finally:
            refused += hooks.requests_refused()
            hooks.refuse_request(-1)
        return None

    outcome = [OTHER_EXCEPTION]

    def judge() -> None:
        torch.set_grad_enabled(False)
        try:
            with entered(refusing):
                results = [call()]
            end = FEWER_THREADS if refused else NOT_REFUSED
        except MemoryError:
            results, end = [], RIGHT
        results.append(call())
        outcome[0] = end if all(same(one, right) for one in results) else OTHER_RESULT

    thread = threading.Thread(target=judge)
    thread.start()
    thread.join()
    return outcome[0]


def in_a_child(function: Callable[[], int]) -> str:
    """What the function says in a forked child, in words, or the signal that ends it."""
    child = os.fork()
    if child == 0:
        signal.alarm(60)
        try:
            os._exit(function())
        finally:
            os._exit(OTHER_EXCEPTION)
    _, status = os.waitpid(child, 0)
    return WORDS[os.WEXITSTATUS(status)] if os.WIFEXITED(status) else signal.Signals(os.WTERMSIG(status)).name


def main() -> None:
    warnings.simplefilter("ignore", DeprecationWarning)  # of forks beside threads
    hooks = ctypes.CDLL(None)
    hooks.refuse_request.argtypes, hooks.requests_refused.restype = (ctypes.c_long,), ctypes.c_long
    torch.set_num_threads(1)
    torch.set_grad_enabled(False)
    torch.get_num_threads = lambda: THREADS  # of the kernels: torch itself has none that a fork could lose
    every, by_kernel, results = calls(), {}, {}
    for name, call in every.items():
        for kernel in reached(call):
            by_kernel.setdefault(kernel, name)
    missing = set(library._library() or ()) - set(by_kernel) - FOR_TESTS
    print("missing:", *sorted(missing))
    for kernel, name in sorted(by_kernel.items()):
        call = every[name]
        right = results.setdefault(name, call())
        words: dict[str, int] = {}
        number = 0
        while WORDS[NOT_REFUSED] not in words:
            word = in_a_child(partial(tried, call, right, kernel, number, hooks))
            words[word] = words.get(word, 0) + 1
            number = number + 1 if number < FIRST else 5 * number // 4
        print(f"{kernel}:", ", ".join(f"{count} {word}" for word, count in words.items()), flush=True)


if __name__ == "__main__":
    sys.exit(main())
