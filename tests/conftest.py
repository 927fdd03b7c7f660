"""Fixtures that more than one room of tests uses."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch

from fingerflow import kernels

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real files with known truth; the test is skipped where it is absent."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"the real recordings are not here: {SHARED_DATA} does not exist")
    return SHARED_DATA


@pytest.fixture
def torch_threads() -> Iterator[Callable[[int], None]]:
    """Sets the number of threads that torch, and with it the package, may use in this test."""
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


@pytest.fixture(params=["compiled", "portable"])
def each_form(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The test runs with the compiled kernels and without."""
    if request.param == "portable":
        monkeypatch.setattr(kernels, "serve", lambda *tensors: False)
    elif not kernels.serve():
        pytest.skip("the compiled kernels were not built or are turned off")
