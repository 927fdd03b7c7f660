"""Tests of errors that a kernel throws on any thread: each becomes an exception of Python, and nothing else happens."""

import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch

from fingerflow.kernels import library
from fingerflow.kernels import tensors as kernels
from tests.embedded import tensors_of
from tests.kernels.kernel_calls import kernel_calls

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

NO_MEMORY, ERROR, UNKNOWN, NO_THREAD = 1, 2, 3, 4  # as in kernels/parallel.h
ANY, CALLER, POOL = 0, 1, 2

FRAMES = torch.arange(2 * 200 * 64, dtype=torch.int64).remainder(251).to(torch.uint8).reshape(2, 1, 200, 64)


@pytest.fixture(autouse=True)
def no_fault_stays(torch_threads: Callable[[int], None]) -> Iterator[None]:
    torch_threads(3)
    yield
    kernels.inject_fault(0)


#: Kernels whose work is not shared by the pool.
UNDIVIDED = {"covered"}
CALLS = {name: call for name, call in kernel_calls().items() if name not in UNDIVIDED} if kernels.serve() else {}


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize(
    ("fault", "raised"), [(NO_MEMORY, MemoryError), (ERROR, RuntimeError), (UNKNOWN, RuntimeError)]
)
def test_a_fault_has_its_own_exception_and_the_name_of_the_kernel(
    name: str, fault: int, raised: type[Exception]
) -> None:
    right = CALLS[name]()
    for piece in (0, -1):
        kernels.inject_fault(fault, piece)
        with pytest.raises(raised, match=f"kernel {name.split()[0]}"):
            CALLS[name]()
    kernels.inject_fault(0)
    for one, other in zip(tensors_of(CALLS[name]()), tensors_of(right), strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=0, equal_nan=True)


@pytest.mark.parametrize("thread", [CALLER, POOL])
def test_a_fault_on_either_kind_of_thread(thread: int) -> None:
    """An error on the calling thread and on a thread of the pool is raised. The system decides which thread does a
    piece of work, so that the test repeats the call for up to 30 s.
    """
    frames = FRAMES.repeat(16, 1, 2, 1)
    right, thrown = kernels.median(frames, 9), False
    kernels.inject_fault(NO_MEMORY, -1, thread)
    end = time.monotonic() + 30
    while not thrown and time.monotonic() < end:
        try:
            assert torch.equal(kernels.median(frames, 9), right)
        except MemoryError:
            thrown = True
    kernels.inject_fault(0)
    assert thrown
    assert torch.equal(kernels.median(frames, 9), right)


def test_a_system_without_threads() -> None:
    """If no thread can be started, fewer threads do the same work."""
    kernels.inject_fault(NO_THREAD)
    torch.set_num_threads(64)
    medians = kernels.median(FRAMES, 9)
    torch.set_num_threads(1)
    assert torch.equal(kernels.median(FRAMES, 9), medians)


@pytest.mark.long
def test_more_memory_than_there_is() -> None:
    """A search over 32,000 px, which needs 4 GB at once, raises MemoryError where the system allows 1 GiB."""
    resource = pytest.importorskip("resource", reason="no limits on memory here")
    code = """
import resource, torch
from fingerflow.kernels.tensors import twin
search = twin("search_windows")
resource.setrlimit(resource.RLIMIT_DATA, (1 << 30, 1 << 30))
images, place, index = torch.zeros(1, 1, 8, 8), torch.zeros(1, 2), torch.zeros(1, dtype=torch.int64)
for threads in (1, 3):
    torch.set_num_threads(threads)
    try:
        search(images, images, index, place, place, (1 << 14) + 1, (1 << 13) - 1)
    except MemoryError as error:
        print(error)
    search(images, images, index, place, place, 5, 1)
"""
    assert resource
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.count("kernel search_windows: no memory") == 2, ran.stdout


def test_every_definition_is_in_the_library() -> None:
    """The library has an entry for every function that its sources define at the begin of a line."""
    sources = Path(__file__).parents[2] / "kernels"
    defined = {
        name for path in sources.glob("*.cpp") for name in re.findall(r"^void fingerflow_(\w+)", path.read_text(), re.M)
    }
    assert defined == set(library.declared())
