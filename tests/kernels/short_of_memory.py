"""Refuse every request for memory of every kernel, one after the other, and print the outcomes, a line for each kernel.

LD_PRELOAD=<failing_new.cpp as a library> python -m tests.kernels.short_of_memory

Each trial is a forked child with a new pool of threads and new workspaces, so that no memory of an earlier call is
left. If the request is refused, the op must raise MemoryError, and give its usual result when it is called again. If
the request was one for a thread of the pool, fewer threads do the work, and the op gives its usual result at once.
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
FIRST = 16  # requests refused one by one; after these, each number is a fourth larger than the last
RIGHT, FEWER_THREADS, NOT_REFUSED, OTHER_EXCEPTION, OTHER_RESULT = range(5)
WORDS = ("MemoryError", "fewer threads", "all granted", "another exception", "another result")
# Entries for tests, which request no memory.
FOR_TESTS = {"limit_instruction_set", "inject_fault"}


def calls() -> dict[str, Callable[[], Any]]:
    """Return calls that reach every kernel, by itself and through the ops."""
    of_ops: dict[str, Callable[[], Any]] = {name: partial(case.call, *case.inputs) for name, case in CASES.items()}
    return kernel_calls() | of_ops


def same(one: Any, other: Any) -> bool:
    pairs = zip(tensors_of(one), tensors_of(other), strict=True)
    return all(torch.allclose(a.double(), b.double(), rtol=0, atol=0, equal_nan=True) for a, b in pairs)


def tried(call: Callable[[], Any], right: Any, wanted: str, number: int, hooks: ctypes.CDLL) -> int:
    """Return the outcome of a call in a new thread, while a request of its kernel `wanted` is refused."""
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
    """Return the outcome of the function in a forked child in words, or the signal that ended the child."""
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
    warnings.simplefilter("ignore", DeprecationWarning)  # warnings about forks with threads
    hooks = ctypes.CDLL(None)
    hooks.refuse_request.argtypes, hooks.requests_refused.restype = (ctypes.c_long,), ctypes.c_long
    torch.set_num_threads(1)
    torch.set_grad_enabled(False)
    torch.get_num_threads = lambda: THREADS  # for the kernels; torch itself has no threads that a fork could lose
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
