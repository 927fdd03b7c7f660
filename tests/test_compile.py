"""Tests of `torch.compile(fullgraph=True)` and `torch.export` of every public op and module: results are the same
numbers.

A new op or module needs inputs in tests/embedded.py.
"""

import shutil
from collections.abc import Callable, Iterator

import pytest
import torch
from torch import Tensor, nn

from fingerflow import ops
from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.tensors import Twin
from fingerflow.ops.tracking.track_points import in_passes
from tests.embedded import CASES, expected, scene, tensors_of, without_a_case
from tests.kernels.kernel_calls import Call, call, kernel_calls

pytestmark = pytest.mark.long

needs_kernels = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

#: Ops whose number of steps depends on data, and the function of each that is one op of a graph.
BY_DATA = {"dense_flow": "whole_flow", "detect_corners": "choose_apart", "track_points": "in_passes"}


@pytest.fixture(autouse=True)
def afresh() -> Iterator[None]:
    torch.compiler.reset()
    expected.cache_clear()
    yield
    torch.compiler.reset()
    expected.cache_clear()


def compiled_as_it_is(name: str, backend: str, *, tolerance: float = 0.0, dynamic: bool = False) -> None:
    case = CASES[name]
    with torch.no_grad():
        compiled = torch.compile(case.call, fullgraph=True, dynamic=dynamic, backend=backend)
        results = tensors_of(compiled(*case.inputs))
    for result, wanted in zip(results, expected(name), strict=True):
        assert result.dtype == wanted.dtype
        torch.testing.assert_close(result, wanted, rtol=tolerance, atol=tolerance, equal_nan=True)


def test_every_op_and_module_has_a_case() -> None:
    assert not without_a_case(), "give these inputs in tests/embedded.py"


@pytest.mark.usefixtures("each_form")
@pytest.mark.parametrize("name", CASES)
def test_whole_and_the_same(name: str) -> None:
    """Compiled results are the same bit for bit, because the same operators run. Fields and points agree to rounding:
    without tracing, the portable form of fields leaves out unknown points, and that of points sums in another order.
    """
    to_rounding = name.startswith(("FieldsGraph", "TrackGraph"))
    compiled_as_it_is(name, "aot_eager", tolerance=1e-6 if to_rounding else 0.0)


class Exported(nn.Module):
    """A case as a module."""

    def __init__(self, call: Callable[..., object]) -> None:
        super().__init__()
        self.call = call

    def forward(self, *inputs: object) -> object:
        return self.call(*inputs)


@pytest.mark.parametrize("name", CASES)
def test_exported_whole_and_the_same(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each case is exported as one graph of fixed shapes, of torch's own ops where possible; results agree to the
    rounding of sums in another order.
    """
    monkeypatch.setattr(kernels, "serve", lambda *tensors: False)
    case = CASES[name]
    program = torch.export.export(Exported(case.call), case.inputs)
    targets = {str(node.target) for node in program.graph.nodes}
    assert not [target for target in targets if "higher_order" in target]
    by_data = BY_DATA.get(name.partition(" ")[0])
    assert {target for target in targets if "fingerflow" in target} == (
        {f"fingerflow.{by_data}.default"} if by_data else set()
    )
    for result, wanted in zip(tensors_of(program.module()(*case.inputs)), expected(name), strict=True):
        assert result.dtype == wanted.dtype
        torch.testing.assert_close(result, wanted, rtol=1e-4, atol=1e-3, equal_nan=True)


@pytest.mark.parametrize("name", ["median_filter", "ContactGraph", "FieldsGraph"])
def test_ops_compiled_by_inductor_agree(name: str) -> None:
    """Results of inductor, which writes loops of its own, agree to the rounding of sums."""
    if shutil.which("g++") is None:
        pytest.skip("no C++ compiler here")
    compiled_as_it_is(name, "inductor", tolerance=1e-4)


@needs_kernels
@pytest.mark.parametrize("name", ["median_filter", "local_gradients - variance", "track_points", "detect_corners"])
def test_compiled_ops_take_batches_of_any_size(name: str) -> None:
    compiled_as_it_is(name, "aot_eager", dynamic=True)


@pytest.mark.usefixtures("each_form")
def test_derivatives_are_those_of_the_op() -> None:
    """Compiled derivatives are those of the op. If a derivative is wanted the portable form is compiled; tracking gives
    the derivative of a position by its images.
    """
    first, second, points, moved = scene(1)
    images = [image.float().requires_grad_() for image in (first, second)]

    def tracked(previous: Tensor, current: Tensor) -> Tensor:
        return ops.track_points(previous, current, points, window=11).points.nan_to_num().sum()

    def fitted(values: Tensor) -> Tensor:
        return ops.local_gradients(points, values, gauge_length=60.0).gradient.square().sum()

    for function, given in ((tracked, images), (fitted, [moved.requires_grad_()])):
        wanted = torch.autograd.grad(function(*given), given)
        compiled: Callable[..., Tensor] = torch.compile(function, fullgraph=True, dynamic=False, backend="aot_eager")
        for found, derivative in zip(torch.autograd.grad(compiled(*given), given), wanted, strict=True):
            assert derivative.abs().max() > 0
            torch.testing.assert_close(found, derivative, rtol=1e-5, atol=1e-6)


def of_kernels() -> dict[str, Call]:
    """Return calls of the package's own ops of torch, by name."""
    first, second, points, _ = scene()
    passes = {
        f"in_passes of {one.dtype}": call(
            in_passes, one, second.to(one.dtype), points, points, None, torch.ones(2), 11, 2, True, 0, 1.0, 0.5
        )
        for one in (first.float(), first.double())
    }
    own = {
        name: one
        for name, one in kernel_calls().items()
        if isinstance(one.function, Twin) or one.function in vars(kernels).values()
    }
    return {**own, **passes}


@needs_kernels
@pytest.mark.parametrize("name", of_kernels() if kernels.serve() else ())
def test_shapes_and_schema_are_true(name: str) -> None:
    function, arguments, settings = of_kernels()[name]
    tests = ("test_schema", "test_faketensor", "test_aot_dispatch_static")
    with torch.no_grad():
        torch.library.opcheck(getattr(torch.ops.fingerflow, function.__name__), arguments, settings, test_utils=tests)
