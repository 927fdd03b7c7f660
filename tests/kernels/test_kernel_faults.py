"""What a kernel throws, on whichever thread, becomes an exception of Python's, and nothing else happens."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
import pytest
import torch

from fingerflow.kernels import block_means, contact_frames, deformation, library, tracked_points
from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.declarations import HEADER, read
from fingerflow.kernels.library import entry
from fingerflow.kernels.tracking_limits import NUMBERS

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

NO_MEMORY, ERROR, UNKNOWN, NO_THREAD = 1, 2, 3, 4  # of kernels/parallel.h
ANY, CALLER, POOL = 0, 1, 2

FRAMES = torch.arange(2 * 200 * 64, dtype=torch.int64).remainder(251).to(torch.uint8).reshape(2, 1, 200, 64)
MASK = FRAMES > 100


@pytest.fixture(autouse=True)
def no_fault_stays(torch_threads: Callable[[int], None]) -> Iterator[None]:
    torch_threads(3)
    yield
    kernels.inject_fault(0)


def calls() -> dict[str, Callable[[], object]]:
    """Functions of all subjects, with work for several threads."""
    light, limits = torch.full((1, 1, 200, 64), 200.0), torch.full((2,), 0.5)
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(2, 40, 2, generator=generator) * 40 + 10
    variance = torch.ones(2)
    templates = kernels.prepare_templates(FRAMES, points, None, variance, 11, True, 0.0)
    coefficients = FRAMES.float()
    lit, sizes = [one.numpy() for one in (FRAMES, light, 0 * light, limits)], {"median_px": 3, "radius": 8}
    return {
        "median": lambda: kernels.median(FRAMES, 5),
        "real_contact_mask": lambda: kernels.real_contact_mask(FRAMES, light, 0 * light, limits, 3),
        "light_gain": lambda: kernels.light_gain(FRAMES, light, 0 * light, 8),
        "contact_of_frames": lambda: arrays_of(contact_frames.contact_of_frames(*lit, cell=4, **sizes)),
        "block_means": lambda: arrays_of(block_means.block_means(lit[0], (2, 2), (4, 4))),
        "contact_threshold": lambda: arrays_of(
            [contact_frames.contact_threshold(*lit[:3], stride_px=1, **sizes)],
        ),
        "apparent_contact": lambda: kernels.apparent_contact(MASK, 8, 4),
        "mean_response": lambda: kernels.mean_response(FRAMES),
        "halve": lambda: kernels.halve(FRAMES),
        "corners": lambda: kernels.corners(
            FRAMES, None, variance, count=9, min_distance=3.0, quality=0.1, window=5, border=0
        ),
        "prepare_templates": lambda: kernels.prepare_templates(FRAMES, points, None, variance, 11, True, 0.0),
        "find_templates": lambda: kernels.find_templates(templates, FRAMES, points, None, None, 1, 0.0, 1.0, 0.5),
        "find_pairs": lambda: kernels.find_pairs(
            FRAMES, FRAMES, points, None, variance, points, 11, True, 8, 0.0, 1.0, 0.5
        ),
        "local_gradients": lambda: kernels.local_gradients(
            points, points, points, None, radius=20.0, least_spread=0.1, minimum_points=5
        ),
        "flow_integrate": lambda: kernels.flow_integrate(coefficients.repeat(1, 1, 8, 8), [0.25, 0.5, 0.25]),
        **on_arrays(),
    }


def on_arrays() -> dict[str, Callable[[], object]]:
    """Functions that take NumPy arrays alone."""
    random = np.random.default_rng(0)
    points = random.uniform(10, 190, (60, 2)).astype(np.float32)
    moved = points + random.normal(size=(2, 60, 2)).astype(np.float32)
    covariance = np.broadcast_to(np.eye(2, dtype=np.float32), (2, 60, 2, 2))
    frame = FRAMES[:1].numpy()
    search: dict[str, Any] = {"window": 9, "radius": 3, "forward_backward_limit": 1.0}
    return {
        "correct_points": lambda: deformation.correct_points(
            points, moved, covariance, np.ones((60, NUMBERS), np.float32), covariance[0], window=25, gauge_px=120.0
        ),
        "find_outliers": lambda: tracked_points.find_outliers(
            tracked_points.find_neighbours(points, 120.0), moved - points, np.ones((2, 60), np.float32)
        ),
        "search_and_return": lambda: tracked_points.search_and_return(frame, frame, points, points, **search),
        "detect_points": lambda: tracked_points.detect_points(
            frame.repeat(2, axis=2), np.ones((400, 64), np.bool_), 20, min_distance_px=6.0, window=9
        ),
    }


def arrays_of(results: Iterable[Any]) -> tuple[torch.Tensor, ...]:
    return tuple(torch.from_numpy(one) for one in results)


CALLS = calls() if kernels.serve() else {}


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
        with pytest.raises(raised, match=f"kernel {name}"):
            CALLS[name]()
    kernels.inject_fault(0)
    assert_same(CALLS[name](), right)


@pytest.mark.parametrize("thread", [CALLER, POOL])
def test_a_fault_on_either_kind_of_thread(thread: int) -> None:
    """Which thread takes a piece is up to the system: on a busy machine all may go to one kind for a while."""
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
    """Fewer threads do the same work."""
    kernels.inject_fault(NO_THREAD)
    torch.set_num_threads(64)
    medians = kernels.median(FRAMES, 9)
    torch.set_num_threads(1)
    assert torch.equal(kernels.median(FRAMES, 9), medians)


def test_more_memory_than_there_is() -> None:
    """A search over 32,000 px takes 4 GB at once, of which the system has been told to give 1."""
    resource = pytest.importorskip("resource", reason="no limits on memory here")
    code = """
import resource, torch
from fingerflow.kernels import tensors as kernels
resource.setrlimit(resource.RLIMIT_DATA, (1 << 30, 1 << 30))
images, place, index = torch.zeros(1, 1, 8, 8), torch.zeros(1, 2), torch.zeros(1, dtype=torch.int64)
for threads in (1, 3):
    torch.set_num_threads(threads)
    try:
        kernels.search_windows(images, images, index, place, place, (1 << 14) + 1, (1 << 13) - 1)
    except MemoryError as error:
        print(error)
    kernels.search_windows(images, images, index, place, place, 5, 1)
"""
    assert resource
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.count("kernel search_windows: no memory") == 2, ran.stdout


def test_a_search_wider_than_its_numbers_is_refused() -> None:
    images, place = torch.zeros(1, 1, 8, 8), torch.zeros(1, 2)
    with pytest.raises(ValueError, match="ends at 32768 px"):
        kernels.search_windows(images, images, torch.zeros(1, dtype=torch.int64), place, place, (1 << 22) + 1, 0)


def test_arguments_go_by_the_names_of_the_header() -> None:
    with pytest.raises(TypeError, match=r"kernel covered .*'transform'"):
        entry("covered")(points=None)
    names = ("density_margin", "batch", "down", "across", "side", "points", "count", "transforms", "covered")
    with pytest.raises(KeyError, match="transform"):
        entry("covered")(**dict.fromkeys(names, 0))


def test_every_declaration_is_in_the_library() -> None:
    declared = read(HEADER.read_text(encoding="utf-8"))
    assert len(declared) > 20
    assert set(library._library() or ()) == set(declared)


@pytest.mark.parametrize(
    ("declaration", "said"),
    [
        ("void fingerflow_f(std::size_t count);", "numbers"),
        ("void fingerflow_f(const float** rows);", "a kind, perhaps"),
        ("struct fingerflow_s { int a; };\nvoid fingerflow_f(const fingerflow_s* s, int a);", "'a'"),
    ],
)
def test_a_declaration_that_cannot_be_packed_is_refused(declaration: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        read(declaration)


def assert_same(result: object, other: object) -> None:
    if isinstance(result, torch.Tensor):
        assert isinstance(other, torch.Tensor)
        torch.testing.assert_close(result, other, rtol=0, atol=0, equal_nan=True)
    elif isinstance(result, np.ndarray):
        np.testing.assert_array_equal(result, other)
    elif isinstance(result, tuple):
        assert isinstance(other, tuple)
        for one, another in zip(result, other, strict=True):
            assert_same(one, another)
