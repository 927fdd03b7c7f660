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
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
import torch

from fingerflow import ops
from fingerflow.kernels import block_means, contact_frames, deformation, library, tracked_points
from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.tracking_limits import NUMBERS
from fingerflow.models.skin_chain import press
from fingerflow.ops.fields.triangle_strain import triangle_strain
from fingerflow.ops.tracking.templates import find_templates, prepare_templates
from tests.embedded import CASES, scene, tensors_of

THREADS = 3
FIRST = 16  # requests that are refused one by one; behind them every fourth more than the last
RIGHT, FEWER_THREADS, NOT_REFUSED, OTHER_EXCEPTION, OTHER_RESULT = range(5)
WORDS = ("MemoryError", "fewer threads", "all granted", "another exception", "another result")
# They work on what they are given, and ask for no memory.
FOR_TESTS = {"limit_instruction_set", "inject_fault"}


def calls() -> dict[str, Callable[[], Any]]:
    """What reaches every kernel, through the ops as far as they do."""
    first, second, points, moved = scene()
    mask = first > 110
    light = torch.full((1, 1, *first.shape[2:]), 200.0)
    tall = first.repeat(1, 1, 4, 1)  # work for several threads
    count = points.shape[1]
    covariance = torch.eye(2).expand(*points.shape, 2).contiguous() / 100
    triangles = torch.tensor([[0, 1, 2], [3, 4, 5], [6, 7, 8]])
    one, other = (frame.repeat(1, 1, 8, 1) for frame in (first, second))  # of flow, whose cells are a fourth

    on_tall = tuple(one.numpy() for one in (tall, *(one.repeat(1, 1, 4, 1) for one in (light, 0 * light))))
    limits = np.full(2, 0.5, np.float32)

    cells = torch.ones(2, 1, *(side // 2 for side in one.shape[2:]))
    of_image = torch.ones(2)
    # By themselves: where dense flow reaches them, its threads are there already.
    of_flow: dict[str, Callable[[], Any]] = {
        "flow_covariance": lambda: kernels.flow_covariance(cells.repeat(1, 3, 1, 1), *[of_image] * 3, 9.0),
        "flow_levels": lambda: kernels.flow_levels(
            cells.repeat(1, 3, 1, 1), cells[..., 1:], cells[..., 1:, :], cells, 3
        ),
        "flow_to_pixels": lambda: kernels.flow_to_pixels(cells.repeat(1, 2, 1, 1), cells, *one.shape[2:]),
    }
    own: dict[str, Callable[[], Any]] = {
        name: lambda case=case: case.call(*case.inputs) for name, case in CASES.items()
    }
    return (
        of_flow
        | own
        | {
            "apparent_contact": lambda: kernels.apparent_contact(mask, 8, 4),
            "real_contact_mask": lambda: kernels.real_contact_mask(
                tall, light.repeat(1, 1, 4, 1), 0 * light.repeat(1, 1, 4, 1), torch.full((2,), 0.5), 3
            ),
            "light_gain": lambda: kernels.light_gain(first, light, 0 * light, 8),
            "contact_of_frames": lambda: _tensors(
                contact_frames.contact_of_frames(*on_tall, limits, median_px=3, radius=8, cell=4)
            ),
            "contact_threshold": lambda: _tensors(
                [contact_frames.contact_threshold(*on_tall, median_px=3, radius=8, stride_px=2)]
            ),
            "block_means": lambda: _tensors(block_means.block_means(on_tall[0], (2, 2), (4, 4))),
            "covered": lambda: _tensors(
                [contact_frames.covered(on_tall[1], points[:1].numpy(), np.ones((2, 3), np.float32), 4)]
            ),
            "templates": lambda: find_templates(prepare_templates(first, points, 11), second, points),
            "mean_response": lambda: kernels.mean_response(tall),
            "halve": lambda: kernels.halve(tall),
            "sample_windows": lambda: kernels.sample_windows(
                tall, torch.zeros(count, dtype=torch.int64), points[0], torch.eye(2).repeat(count, 1, 1), 9, 1
            ),
            "spline_coefficients": lambda: kernels.spline_coefficients(tall),
            "dense_flow": lambda: ops.dense_flow(one, other),
            "triangle_strain": lambda: triangle_strain(
                points[:1], triangles, moved, covariance, torch.ones(2, 3, dtype=torch.bool)
            ),
            "skin_chain": lambda: press(torch.tensor([0.2, 0.6]), elements=9).position,
        }
        | on_arrays(tall)
    )


def on_arrays(frames: torch.Tensor) -> dict[str, Callable[[], Any]]:
    """What takes NumPy arrays alone; results as tensors."""
    random = np.random.default_rng(0)
    points = random.uniform(10, 190, (60, 2)).astype(np.float32)
    moved = points + random.normal(size=(2, 60, 2)).astype(np.float32)
    covariance = np.broadcast_to(np.eye(2, dtype=np.float32), (2, 60, 2, 2))
    frame = frames[:1].numpy()
    neighbours = tracked_points.find_neighbours(points, 120.0)
    search: dict[str, Any] = {"window": 9, "radius": 3, "forward_backward_limit": 1.0}
    named: dict[str, Callable[[], Any]] = {
        "correct_points": lambda: deformation.correct_points(
            points, moved, covariance, np.ones((60, NUMBERS), np.float32), covariance[0], window=25, gauge_px=120.0
        ),
        "find_outliers": lambda: tracked_points.find_outliers(neighbours, moved - points, np.ones((2, 60), np.float32)),
        "search_and_return": lambda: tracked_points.search_and_return(frame, frame, points, points, **search),
        "detect_points": lambda: tracked_points.detect_points(
            frame, np.ones(frame.shape[2:], np.bool_), 20, min_distance_px=6.0, window=9
        ),
    }
    return {name: lambda call=call: _tensors(call()) for name, call in named.items()}


def _tensors(arrays: Iterable[Any]) -> tuple[torch.Tensor, ...]:
    return tuple(torch.from_numpy(array) for array in arrays)


@contextmanager
def entered(seen: Callable[[str, Callable[[], None]], None]) -> Iterator[None]:
    """Within it `seen` gets the name of every kernel that is entered, and what enters it."""
    plain = library.Entry.__call__

    def called(self: library.Entry, **given: Any) -> None:
        seen(self._name, lambda: plain(self, **given))

    library.Entry.__call__ = called  # type: ignore[method-assign]
    try:
        yield
    finally:
        library.Entry.__call__ = plain  # type: ignore[method-assign]


def reached(call: Callable[[], Any]) -> set[str]:
    names: set[str] = set()

    def noted(name: str, enter: Callable[[], None]) -> None:
        names.add(name)
        enter()

    with entered(noted):
        call()
    return names


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
