"""Tests of kernels on NumPy arrays: they give the numbers that they give for tensors, and need no torch."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from fingerflow.kernels import contact, fields, flow, library, tracking
from fingerflow.kernels import tensors as kernels
from tests.kernels.kernel_calls import calls

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

SUBJECTS = (contact, fields, flow, tracking)
FUNCTIONS = {
    name: value
    for subject in SUBJECTS
    for name, value in vars(subject).items()
    if hasattr(kernels, name) and getattr(value, "__module__", "") == subject.__name__
}
FRAME = np.random.default_rng(0).integers(0, 256, (2, 1, 40, 60), dtype=np.uint8)
POINTS = np.array([[[20.25, 18.5], [33.0, 21.75]], [[15.5, 25.0], [np.nan, 4.0]]], np.float32)
ONES = np.ones(2, np.float32)


def in_numpy(value: Any) -> Any:
    """Return the value with copies in NumPy arrays in place of tensors."""
    if isinstance(value, Tensor):
        return value.detach().numpy().copy()
    return type(value)(map(in_numpy, value)) if type(value) in (list, tuple) else value


def parts(result: Any) -> list[Any]:
    return list(result) if isinstance(result, tuple) else [result]


def assert_same(result: Any, tensors: Any) -> None:
    """Assert that the result has the same kind of tuple, shapes, dtypes and numbers as `tensors`, in NumPy arrays."""
    assert type(result) is type(tensors) or isinstance(tensors, Tensor)
    for one, other in zip(parts(result), parts(tensors), strict=True):
        if other is None:
            assert one is None
            continue
        wanted = other.numpy()
        assert type(one) is np.ndarray
        assert (one.dtype, one.shape) == (wanted.dtype, wanted.shape)
        assert np.array_equal(one, wanted, equal_nan=wanted.dtype.kind == "f")


def test_every_function_gives_what_it_gives_for_tensors(monkeypatch: pytest.MonkeyPatch) -> None:
    """For all calls of the ops, every function of kernels gives the same bits for arrays as for tensors, because the
    same code runs.
    """
    called: set[str] = set()

    def beside(name: str, of_tensors: Callable[..., Any]) -> Callable[..., Any]:
        def both(*args: Any, **kwargs: Any) -> Any:
            given = [in_numpy(one) for one in args], {key: in_numpy(one) for key, one in kwargs.items()}
            result = of_tensors(*args, **kwargs)
            assert_same(FUNCTIONS[name](*given[0], **given[1]), result)
            called.add(name)
            return result

        return both

    for name in FUNCTIONS:
        monkeypatch.setattr(kernels, name, beside(name, getattr(kernels, name)))
    with torch.no_grad():
        for call in calls().values():
            call()
    assert called == set(FUNCTIONS)


def followed(frames: Any, points: Any, variance: Any) -> Any:
    templates = tracking.prepare_templates(frames, points, None, variance, 11, True, 0.0)
    return tracking.find_templates(templates, frames, points, None, None, 2, 0.0, 1.0, 0.5)


def test_views_however_they_lie_in_memory() -> None:
    wanted = followed(FRAME, POINTS, ONES)
    wide = np.zeros((2, 1, 50, 80), np.uint8)
    wide[:, :, 5:45, 10:70] = FRAME
    mirrored = FRAME[..., ::-1].copy()[..., ::-1]
    upside_down = FRAME[:, :, ::-1].copy()[:, :, ::-1]
    columns_first = np.asfortranarray(FRAME)
    every_second = np.repeat(FRAME, 2, axis=3)[..., ::2]
    protected = FRAME.copy()
    protected.flags.writeable = False
    for view in (wide[:, :, 5:45, 10:70], mirrored, upside_down, columns_first, every_second, protected):
        for one, other in zip(followed(view, np.asfortranarray(POINTS), ONES), wanted, strict=True):
            assert np.array_equal(one, other, equal_nan=True)


def test_numbers_that_lie_between_addresses() -> None:
    """Unaligned arrays, such as a field of a record of a file, give the same numbers."""
    raw = np.zeros(1 + FRAME.size * 4, np.uint8)
    frames = raw[1:].view(np.float32).reshape(FRAME.shape)
    frames[:] = FRAME
    assert not frames.flags.aligned
    for one, other in zip(followed(frames, POINTS, ONES), followed(FRAME, POINTS, ONES), strict=True):
        assert np.array_equal(one, other, equal_nan=True)


def test_no_points_and_no_frames() -> None:
    none = np.zeros((2, 0, 2), np.float32)
    assert followed(FRAME, none, ONES).points.shape == (1, 2, 0, 2)
    templates = tracking.prepare_templates(FRAME, POINTS, None, ONES, 11, True, 0.0)
    found = tracking.find_templates(templates, FRAME[:0], POINTS, None, None, 2, 0.0, 1.0, 0.5)
    assert found.points.shape == (0, 2, 2, 2)
    assert np.array_equal(found.place, POINTS, equal_nan=True)
    assert tracking.halve(FRAME[:0]).shape == (0, 1, 20, 30)


def test_views_that_torch_negates_are_written_out() -> None:
    frames = torch.from_numpy(FRAME).float()
    conjugate = torch.complex(frames, -frames).conj().imag
    assert conjugate.is_neg()
    assert torch.equal(kernels.halve(conjugate), kernels.halve(frames))


def test_other_dtypes_are_refused() -> None:
    with pytest.raises(TypeError, match="frames are float64: this compiled kernel takes uint8 or"):
        tracking.halve(FRAME.astype(np.float64))
    with pytest.raises(TypeError, match="frames are >u2"):
        tracking.halve(FRAME.astype(">u2"))
    with pytest.raises(ValueError, match="points is float64"):
        followed(FRAME, POINTS.astype(np.float64), ONES)


def test_threads_are_those_of_torch(torch_threads: Callable[[int], None]) -> None:
    torch_threads(3)
    assert library.threads() == 3
    library.set_threads(2)
    assert library.threads() == torch.get_num_threads() == 2


ALONE = """
import importlib.abc, sys

class Blocker(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "scipy", "cv2", "onnxruntime"):
            raise ImportError(f"{name} is not installed here")

sys.meta_path.insert(0, Blocker())

import numpy as np
from fingerflow.kernels import library, tracking

assert library.is_present()
assert library.threads() == 2, library.threads()
library.set_threads(3)
assert library.threads() == 3
given = np.load(sys.argv[1])
templates = tracking.prepare_templates(given["frames"], given["points"], None, given["variance"], 11, True, 0.0)
found = tracking.find_templates(templates, given["frames"], given["points"], None, None, 2, 0.0, 1.0, 0.5)
np.savez(sys.argv[2], **found._asdict())
assert "torch" not in sys.modules
"""


def test_kernels_on_arrays_give_the_same_bits_without_torch(tmp_path: Path) -> None:
    """In a process that cannot import torch, kernels on NumPy arrays give the same bits as on tensors here."""
    given, found = tmp_path / "given.npz", tmp_path / "found.npz"
    np.savez(given, frames=FRAME, points=POINTS, variance=ONES)
    environment = {**os.environ, "OMP_NUM_THREADS": "2"}
    command = [sys.executable, "-c", ALONE, str(given), str(found)]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
    assert ran.returncode == 0, ran.stderr
    wanted = followed(*map(torch.from_numpy, (FRAME, POINTS, ONES)))
    with np.load(found) as results:
        for name, tensor in wanted._asdict().items():
            assert np.array_equal(results[name], tensor.numpy(), equal_nan=name != "status"), name
