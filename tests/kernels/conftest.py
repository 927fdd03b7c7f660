"""Fixtures of the tests of compiled kernels: instruction sets and the portable form."""

from collections.abc import Callable, Iterator

import pytest

from fingerflow.kernels import tensors as kernels
from tests.without_kernels import without_kernels


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
            without_kernels(patch)
            return function()

    return call
