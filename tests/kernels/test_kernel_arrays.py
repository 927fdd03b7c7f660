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

from fingerflow.kernels import kernel, tracking
from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.library import compiled
from tests.embedded import tensors_of
from tests.kernels.kernel_calls import calls, entered, in_tensors

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

FRAME = np.random.default_rng(0).integers(0, 256, (2, 1, 40, 60), dtype=np.uint8)
POINTS = np.array([[[20.25, 18.5], [33.0, 21.75]], [[15.5, 25.0], [np.nan, 4.0]]], np.float32)
ONES = np.ones(2, np.float32)


def in_numpy(value: Any) -> Any:
    """Return the value with copies in NumPy arrays in place of tensors."""
    if isinstance(value, Tensor):
        return value.detach().numpy().copy()
    return type(value)(map(in_numpy, value)) if type(value) in (list, tuple) else value


def test_every_kernel_gives_what_it_gives_for_tensors() -> None:
    """For all calls of the ops, every kernel gives the same bits for arrays as for tensors."""
    called: set[str] = set()

    def both(name: str, values: dict[str, Any], enter: Callable[[], Any]) -> Any:
        results = enter()
        if name not in called and name != "flow_descend":  # whose levels hold addresses of tensors
            called.add(name)
            of_arrays = compiled(name)(**{key: in_numpy(value) for key, value in values.items()})
            for array, tensor in zip(*(tensors_of(in_tensors(one)) for one in (of_arrays, results)), strict=True):
                torch.testing.assert_close(array, tensor, rtol=0, atol=0, equal_nan=True)
        return results

    with torch.no_grad(), entered(both):
        for call in calls().values():
            call()
    assert len(called) > 20


def followed(frames: Any, points: Any, variance: Any) -> Any:
    arrays = {"image": frames, "start": points, "inverse_warp": None, "variance": variance}
    templates = compiled("prepare_templates")(**arrays, window=11, gain_offset=1, rounding=0.0)
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
    between = np.zeros(1 + FRAME.size * 2, np.uint8)[1:].view(np.uint16).reshape(FRAME.shape)
    between[:] = FRAME  # not aligned, as a field of a record of a file
    for view in (wide[:, :, 5:45, 10:70], mirrored, upside_down, columns_first, every_second, protected, between):
        for one, other in zip(followed(view, np.asfortranarray(POINTS), ONES), wanted, strict=True):
            assert np.array_equal(one, other, equal_nan=True)


def test_no_points_and_no_frames() -> None:
    assert followed(FRAME, np.zeros((2, 0, 2), np.float32), ONES)[0].shape == (1, 2, 0, 2)
    arrays = {"image": FRAME, "start": POINTS, "inverse_warp": None, "variance": ONES}
    templates = compiled("prepare_templates")(**arrays, window=11, gain_offset=1, rounding=0.0)
    points, *_, position, _ = tracking.find_templates(templates, FRAME[:0], POINTS, None, None, 2, 0.0, 1.0, 0.5)
    assert points.shape == (0, 2, 2, 2)
    assert np.array_equal(position, POINTS, equal_nan=True)
    assert compiled("halve")(frames=FRAME[:0]).shape == (0, 1, 20, 30)


def test_views_that_torch_negates_are_written_out() -> None:
    frames = torch.from_numpy(FRAME).float()
    conjugate = torch.complex(frames, -frames).conj().imag
    assert conjugate.is_neg()
    assert torch.equal(compiled("halve")(frames=conjugate), compiled("halve")(frames=frames))


def test_threads_are_those_of_torch(torch_threads: Callable[[int], None]) -> None:
    torch_threads(3)
    assert kernel.threads() == 3
    kernel.set_threads(2)
    assert kernel.threads() == torch.get_num_threads() == 2


ALONE = """
import importlib.abc, sys

class Blocker(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "scipy", "cv2", "onnxruntime"):
            raise ImportError(f"{name} is not installed here")

sys.meta_path.insert(0, Blocker())

import numpy as np
from fingerflow.kernels import kernel, library, tracking

assert library.is_present()
assert kernel.threads() == 2, kernel.threads()
kernel.set_threads(3)
assert kernel.threads() == 3
given = np.load(sys.argv[1])
arrays = {"image": given["frames"], "start": given["points"], "inverse_warp": None, "variance": given["variance"]}
templates = library.compiled("prepare_templates")(**arrays, window=11, gain_offset=1, rounding=0.0)
found = tracking.find_templates(templates, given["frames"], given["points"], None, None, 2, 0.0, 1.0, 0.5)
np.savez(sys.argv[2], *found)
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
        for name, tensor in zip(results.files, wanted, strict=True):
            assert np.array_equal(results[name], tensor.numpy(), equal_nan=tensor.is_floating_point()), name
