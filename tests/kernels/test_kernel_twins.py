"""Tests of every op with a compiled twin: both forms agree, with any instruction set, strides and number of threads."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from tests.embedded import tensors_of
from tests.kernels.kernel_calls import reached
from tests.kernels.twins import TWINS, Tolerance, Twin

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

Portable = Callable[[Callable[[], object]], Any]


def changed(given: Any, change: Callable[[Tensor], Tensor]) -> Any:
    """Return the same arguments with every tensor changed."""
    if isinstance(given, Tensor):
        return change(given)
    if isinstance(given, tuple):
        parts = [changed(part, change) for part in given]
        return type(given)(*parts) if hasattr(given, "_fields") else tuple(parts)
    return given


def assert_close(found: Any, expected: Any, tolerance: Tolerance = (0.0, 0.0), **by_name: Tolerance) -> None:
    """Assert equal dtypes and shapes, equal integers, flags and NaN, and floats within the tolerance."""
    if isinstance(found, tuple):
        names = getattr(found, "_fields", [""] * len(found))
        for name, one, other in zip(names, found, expected, strict=True):
            assert_close(one, other, by_name.get(name, tolerance))
    elif not isinstance(found, Tensor):
        assert found == expected
    else:
        rtol, atol = tolerance if found.is_floating_point() else (0.0, 0.0)
        torch.testing.assert_close(found, expected, rtol=rtol, atol=atol, equal_nan=True)


def in_double(tensor: Tensor) -> Tensor:
    return tensor.double() if tensor.is_floating_point() else tensor


@pytest.mark.parametrize("name", TWINS)
def test_compiled_twins_agree_with_portable_ops(name: str, instruction_sets: list[int], portable: Portable) -> None:
    twin = TWINS[name]
    for op, given in twin.calls():
        same = changed(given, in_double) if twin.in_double else given
        expected = portable(lambda op=op, same=same: op(*same))
        for most in instruction_sets:
            kernels.limit_instruction_set(most)
            found = op(*given)
            assert_close(
                changed(found, in_double) if twin.in_double else found, expected, twin.tolerance, **twin.by_name
            )


def largest(twin: Twin) -> tuple[Callable[..., Any], tuple[Any, ...]]:
    return list(twin.calls())[-1]


@pytest.mark.parametrize("name", TWINS)
def test_the_compiled_form_serves(name: str) -> None:
    """The compiled form is used and most results are finite; otherwise the portable form would be compared with itself,
    or NaN with NaN. The input is left as it was.
    """
    op, given = largest(TWINS[name])
    before = changed(given, torch.clone)
    assert reached(lambda: op(*given))
    assert_close(given, before)
    for tensor in tensors_of(op(*given)):
        assert tensor.isfinite().double().mean() > 0.3


@pytest.mark.parametrize("name", TWINS)
def test_threads_and_strides_change_nothing(name: str, torch_threads: Callable[[int], None]) -> None:
    """Results are the same bit for bit with one thread or several, which share frames or bands of one frame, and for
    views of any strides.
    """
    op, given = largest(TWINS[name])
    torch_threads(1)
    expected = op(*given)
    for threads in (2, 3, 7):
        torch_threads(threads)
        assert_close(op(*given), expected)
    for view in (
        lambda one: one.repeat_interleave(2, -1)[..., ::2],
        lambda one: one.repeat_interleave(2, 0)[::2],
        lambda one: one.mT.contiguous().mT if one.ndim > 1 else one,
        lambda one: torch.nn.functional.pad(one, (3, 2))[..., 3:-2],
    ):
        assert_close(op(*changed(given, view)), expected)


@pytest.mark.parametrize("name", TWINS)
def test_frames_of_a_batch_do_not_know_each_other(name: str) -> None:
    op, given = largest(TWINS[name])
    sizes = {len(one) for one in tensors_of(given)} - {1}
    if len(sizes) != 1 or "search" in name or "windows" in name:
        pytest.skip("its tensors have no dimension of frames in common")
    together = op(*given)
    for number in range(max(sizes)):
        frame = one_of(number)
        assert_close(op(*changed(given, frame)), changed(together, frame))


def one_of(number: int) -> Callable[[Tensor], Tensor]:
    """Return a function that takes frame `number` of a batch; a tensor of one frame serves all frames."""
    return lambda one: one[number : number + 1] if len(one) > 1 else one
