"""Fixtures of the tests of compiled kernels: instruction sets and the portable form."""

from collections.abc import Callable, Iterator
from importlib.util import find_spec

import pytest
import torch

from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.tensors import serving
from tests.kernels.fused import GPU_TILES


@pytest.fixture(params=[0, 1, 2], ids=["baseline", "avx2", "avx512"])
def instruction_set(request: pytest.FixtureRequest) -> Iterator[int]:
    """Limit the kernels to each instruction set that this processor and build have, in turn; yield its number."""
    if not kernels.serve():
        pytest.skip("the compiled kernels were not built or are turned off")
    if kernels.limit_instruction_set(request.param) != request.param:
        kernels.limit_instruction_set(-1)
        pytest.skip("this processor or build has no such instruction set")
    yield request.param
    kernels.limit_instruction_set(-1)


@pytest.fixture
def instruction_sets() -> Iterator[list[int]]:
    """Yield the numbers of all instruction sets that this processor and build have."""
    yield [most for most in (0, 1, 2) if kernels.limit_instruction_set(most) == most]
    kernels.limit_instruction_set(-1)


@pytest.fixture
def portable(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], object]], object]:
    """Return a function that calls another one with the compiled kernels turned off."""

    def call(function: Callable[[], object]) -> object:
        with monkeypatch.context() as patch:
            patch.setattr(kernels, "serve", lambda *tensors: False)
            return function()

    return call


@pytest.fixture
def tiles(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Enlarge the tiles of Triton kernels, unless the parameter of the test is `GPU_TILES`: Triton's interpreter takes
    as long for a small tile as for a large one.
    """
    if getattr(request, "param", "") != GPU_TILES and not torch.cuda.is_available() and find_spec("triton") is not None:
        from fingerflow.kernels.tensors import fused_fits, fused_medians, fused_outliers, fused_pixels

        for module in (fused_fits, fused_medians):
            monkeypatch.setattr(module, "QUERIES", 256)
        monkeypatch.setattr(fused_outliers, "POINTS", 256)
        monkeypatch.setattr(fused_pixels, "PIXELS", 8192)


@pytest.fixture
def fused(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Turn the compiled kernels off, as on a GPU without Triton; kernels of Triton serve once the result is called."""
    for module in (kernels, serving):
        monkeypatch.setattr(module, "serve", lambda *tensors: False)
    monkeypatch.setattr(serving, "_is_on_gpu", lambda tensor: False)
    return lambda: monkeypatch.setattr(serving, "_is_on_gpu", lambda tensor: True)
