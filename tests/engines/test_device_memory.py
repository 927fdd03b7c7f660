"""Tests of the memory planned for recordings computed together, and of errors of memory."""

import pytest
import torch

from bench.launches import count_launches
from bench.suites.gpu import _works
from fingerflow.engines.memory import FRAMES, TOGETHER, bytes_of_recording, recordings_that_fit
from fingerflow.errors import is_out_of_memory


@pytest.mark.parametrize(("shape", "points"), [((512, 640), 700), ((256, 320), 200), ((512, 640), 1400)])
def test_more_is_planned_than_is_counted(shape: tuple[int, int], points: int) -> None:
    """The planned bytes of a recording exceed those counted in the steps of a frame by less than 2.5 times: templates,
    copies for graphs and frames of 32 bit need more.
    """
    works = _works(shape, points, 1)
    peaks = {name: count_launches(one.graph, one.inputs).peak for name, one in works.items() if name != "points"}
    assert peaks["contact"] > 4 * shape[0] * shape[1]
    assert peaks["deformation"] > 4 * points**2
    of_frame = peaks["contact"] + max(peaks["deformation"], peaks["outliers"])
    counted = FRAMES * of_frame + peaks["key"] + peaks["tracking"]
    assert counted < bytes_of_recording(*shape, points, 21) < 2.5 * counted


def test_recordings_that_fit() -> None:
    of_one = bytes_of_recording(512, 640, 700, 25)
    assert recordings_that_fit(0, 512, 640, 700, 25) == 1
    few, more, many = (recordings_that_fit(size * 1e9, 512, 640, 700, 25) for size in (6, 8, 80))
    assert more - few == pytest.approx(0.7 * 2e9 / of_one, abs=1)
    assert few > 8
    assert many == TOGETHER


def test_errors_of_memory() -> None:
    assert is_out_of_memory(MemoryError())
    assert is_out_of_memory(torch.OutOfMemoryError("CUDA out of memory"))
    assert is_out_of_memory(RuntimeError("DefaultCPUAllocator: can't allocate memory"))
    assert not is_out_of_memory(RuntimeError("shapes do not match"))
    assert not is_out_of_memory(ValueError("allocate memory"))
