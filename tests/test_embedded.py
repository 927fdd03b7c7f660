"""Tests of every public op and module of the graphs: default dtype and device of the process change nothing, and
`torch.compile`, `torch.export`, `torch.func.vmap` and an accelerator give the same numbers.

A new op or module needs inputs in tests/embedded.py.
"""

import functools
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import onnxruntime
import pytest
import torch
from torch import Tensor, nn
from torch.autograd import forward_ad
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

from fingerflow import ops
from fingerflow.export.build import build_graphs
from fingerflow.export.standard_model import keep_operators
from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.outlier_limits import NEIGHBOURS
from fingerflow.ops.contact import apparent_contact, otsu
from fingerflow.ops.tracking.track_points import in_passes
from fingerflow.schema.recipe import GRAPHS, Recipe, load_recipe
from tests.embedded import CASES, expected, scene, tensors_of, without_a_case
from tests.kernels.kernel_calls import Call, call, kernel_calls
from tests.without_kernels import without_kernels

needs_kernels = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

#: Ops whose number of steps depends on data, and the function of each that is one op of a graph.
BY_DATA = {"dense_flow": "whole_flow", "detect_corners": "choose_apart", "track_points": "in_passes"}

POINTS = scene(1)[2]
OF_OPS = [  # without a variance `local_gradients` returns None for the covariance, which vmap refuses
    name for name in CASES if name.partition(" ")[0] in ops.__all__ and name != "local_gradients"
]
HEIGHT, WIDTH, COUNT = 96, 128, 40  # of the recipes
RECIPES = {path.stem: path for path in sorted((Path(__file__).parents[1] / "export").glob("*.toml"))}


#: Operations whose result, or its size, depends on values: the host waits for them.
WAITS = {
    f"aten::{name}"
    for name in (
        *("_local_scalar_dense", "item", "is_nonzero", "equal", "nonzero", "nonzero_numpy", "argwhere"),
        *("masked_select", "_unique", "_unique2", "unique_dim", "unique_consecutive", "bincount"),
        *("repeat_interleave.Tensor", "repeat_interleave.self_Tensor"),
        *("linalg_eigh", "_linalg_eigh", "linalg_inv", "_linalg_check_errors"),
    )
}


@pytest.fixture(autouse=True)
def afresh() -> Iterator[None]:
    yield
    torch.set_default_dtype(torch.float32)
    torch.set_default_device(None)
    torch.compiler.reset()
    expected.cache_clear()  # cached by the other form


def test_every_op_and_module_has_a_case() -> None:
    assert not without_a_case(), "give these inputs in tests/embedded.py"


@pytest.mark.usefixtures("each_form")
@pytest.mark.parametrize("name", CASES)
def test_default_dtype_and_device(name: str) -> None:
    case, wanted = CASES[name], expected(name)
    for dtype, device in ((torch.float64, None), (torch.bfloat16, None), (torch.float32, "meta")):
        # Tensors that ops keep from call to call may come from before the defaults changed.
        otsu._bin_of_level.cache_clear()
        apparent_contact._kept_boxes.cache_clear()
        torch.set_default_dtype(dtype)
        torch.set_default_device(device)
        with torch.no_grad():
            for result, other in zip(tensors_of(case.call(*case.inputs)), wanted, strict=True):
                assert result.dtype == other.dtype
                assert result.device == other.device
                assert torch.equal(result.nan_to_num(-7.0), other.nan_to_num(-7.0))


@pytest.mark.usefixtures("each_form")
@pytest.mark.parametrize("gradients", [False, True])
@pytest.mark.parametrize("name", CASES)
def test_autocast_changes_nothing(name: str, gradients: bool) -> None:
    """Results and their derivatives are the same, to the bit, inside `torch.autocast`."""

    def run(autocast: bool) -> list[Tensor]:
        inputs = [
            one.clone().requires_grad_(gradients) if isinstance(one, Tensor) and one.is_floating_point() else one
            for one in CASES[name].inputs
        ]
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=autocast):
            results = tensors_of(CASES[name].call(*inputs))
        leaves = [one for one in inputs if isinstance(one, Tensor) and one.requires_grad]
        sums = [one.nan_to_num().sum() for one in results if one.requires_grad]
        return [*results, *(torch.autograd.grad(sums, leaves, materialize_grads=True) if sums else ())]

    for result, wanted in zip(run(True), run(False), strict=True):
        assert result.dtype == wanted.dtype
        assert torch.equal(result.nan_to_num(-7.0), wanted.nan_to_num(-7.0))


def test_ops_are_independent_of_default_dtype_and_device_at_import() -> None:
    """Tensors made once, at import or in the first call, have their own dtype and device whatever the defaults are
    then.
    """
    code = """
import torch
torch.set_default_dtype(torch.float64)
torch.set_default_device("meta")
from fingerflow import graphs, ops

cpu = dict(dtype=torch.float32, device="cpu")
points = torch.cartesian_prod(torch.arange(8, **cpu), torch.arange(8, **cpu))[None]
ellipse = torch.full((1, 2), 4.0, **cpu), torch.full((1, 2), 3.0, **cpu), torch.zeros(1, **cpu)
fields = graphs.FieldsGraph(6.0)(points, points / 10, None, graphs.FrameEllipse(*ellipse))
assert fields.median.dtype == torch.float32 and abs(fields.median[0, 0].item() - 0.2) < 0.02, fields.median
frame = torch.arange(64, dtype=torch.uint8, device="cpu").repeat(64, 1)[None, None]
print(ops.otsu_threshold(frame).item(), ops.median_filter(frame, 3).sum().item() / 64)
"""
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ran.stdout.split() == ["31.0", str(32.0 * 63)], ran.stderr


@pytest.mark.parametrize("last", [0, 1])
@pytest.mark.parametrize("name", OF_OPS)
def test_equals_a_loop(name: str, last: int) -> None:
    """vmap of an op, over all its tensors or the last alone, agrees with a loop to rounding: the loop uses the compiled
    kernels, which sum in another order.
    """
    case = CASES[name]
    tensors = [k for k, one in enumerate(case.inputs) if isinstance(one, Tensor) and one.dtype != torch.int64]
    dims = tuple(0 if k in tensors[-last:] else None for k in range(len(case.inputs)))
    inputs = [
        one if dim is None else torch.stack((one, one.roll(1, 0))) for one, dim in zip(case.inputs, dims, strict=True)
    ]
    results = tensors_of(torch.func.vmap(case.call, in_dims=dims)(*inputs))
    rows = [
        tensors_of(case.call(*(one if dim is None else one[k] for one, dim in zip(inputs, dims, strict=True))))
        for k in range(2)
    ]
    for result, *wanted in zip(results, *rows, strict=True):
        torch.testing.assert_close(result, torch.stack(wanted), rtol=1e-4, atol=1e-4, equal_nan=True)


def pairs() -> tuple[Tensor, Tensor]:
    """Return two pairs of images (2, 1, 1, H, W), float32."""
    first, second = (torch.stack((one, one.roll(2, 3))).float() for one in scene(1)[:2])
    return first, second


def tracked(previous: Tensor, current: Tensor) -> Tensor:
    """Return the sum of the positions, whose derivative by the images is not 0."""
    return ops.track_points(previous, current, POINTS, window=11).points.nan_to_num().sum()


def flow(previous: Tensor, current: Tensor) -> Tensor:
    return ops.dense_flow(previous, current).displacement.nan_to_num().sum()


def test_derivative_inside_and_outside_the_map() -> None:
    """Derivatives inside and outside vmap are right, although vmap hides from an op that a derivative is wanted."""
    previous, current = pairs()
    wanted = torch.stack(
        [
            torch.autograd.grad(tracked(first, given), given)[0]
            for first, given in zip(previous, current.clone().requires_grad_(), strict=True)
        ]
    )
    assert wanted.abs().max() > 1e-4

    def total(images: Tensor) -> Tensor:
        return torch.func.vmap(tracked)(previous, images).sum()

    leaf = current.clone().requires_grad_()
    total(leaf).backward()
    inside = torch.func.vmap(torch.func.grad(tracked, argnums=1))(previous, current)
    for found in (leaf.grad, torch.func.grad(total)(current), inside):
        torch.testing.assert_close(found, wanted, rtol=1e-4, atol=1e-6)


def test_no_derivative_is_an_error_and_not_zero() -> None:
    previous, current = pairs()
    sentence = r"has no derivative under torch\.func\.vmap: pass a batch \(B, \.\.\.\) instead"
    with pytest.raises(RuntimeError, match=sentence):
        torch.func.grad(lambda images: torch.func.vmap(flow)(previous, images).sum())(current)
    with pytest.raises(RuntimeError, match=sentence):
        torch.func.vmap(torch.func.grad(flow))(previous, current)


@pytest.mark.parametrize("name", CASES)
def test_forward_mode_agrees_with_backward(name: str) -> None:
    """The tangent of the sum of the results is the same by `torch.func.jvp` and `forward_ad` as by `backward`."""
    inputs = CASES[name].inputs
    at = [k for k, one in enumerate(inputs) if isinstance(one, Tensor) and one.is_floating_point()]
    floats = tuple(inputs[k].double() for k in at)

    def total(*changed: Tensor) -> Tensor:
        given = dict(zip(at, changed, strict=True))
        results = tensors_of(CASES[name].call(*(given.get(k, one) for k, one in enumerate(inputs))))
        return torch.cat([one[one.isfinite()].double() for one in (*results, *changed)]).sum()

    if at:
        _, wanted = torch.autograd.functional.jvp(total, floats, floats)
        with forward_ad.dual_level():
            direct = forward_ad.unpack_dual(total(*map(forward_ad.make_dual, floats, floats))).tangent
        for found in (direct, torch.func.jvp(total, floats, floats)[1]):
            torch.testing.assert_close(found, wanted, rtol=1e-4, atol=1e-4)


def compiled_as_it_is(name: str, backend: str, *, tolerance: float = 0.0, dynamic: bool = False) -> None:
    case = CASES[name]
    with torch.no_grad():
        compiled = torch.compile(case.call, fullgraph=True, dynamic=dynamic, backend=backend)
        results = tensors_of(compiled(*case.inputs))
    for result, wanted in zip(results, expected(name), strict=True):
        assert result.dtype == wanted.dtype
        torch.testing.assert_close(result, wanted, rtol=tolerance, atol=tolerance, equal_nan=True)


@pytest.mark.long
@pytest.mark.usefixtures("each_form")
@pytest.mark.parametrize("name", CASES)
def test_whole_and_the_same(name: str) -> None:
    """Compiled results are the same bit for bit, because the same operators run. Fields and points agree to rounding:
    without tracing, the portable form of fields leaves out unknown points, and that of points sums in another order.
    """
    to_rounding = name.startswith(("FieldsGraph", "TrackGraph"))
    compiled_as_it_is(name, "aot_eager", tolerance=1e-6 if to_rounding else 0.0)


class Exported(nn.Module):
    """Module that calls the op of a case, to be exported."""

    def __init__(self, call: Callable[..., object]) -> None:
        super().__init__()
        self.call = call

    def forward(self, *inputs: object) -> object:
        result = self.call(*inputs)
        return result if isinstance(result, Tensor) else tuple(tensors_of(result))


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(CASES.keys() - {"median_filter - large"}))  # large for `torch.compile` alone
def test_exported_whole_and_the_same(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each case is exported as one graph of fixed shapes, of torch's own ops where possible; results agree to the
    rounding of sums in another order.
    """
    without_kernels(monkeypatch)
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


NETWORK = ("normalize_illumination", "otsu_threshold", "local_gradients", "divergence")


def network(*inputs: Tensor) -> tuple[Tensor, ...]:
    """Return the results of several ops, each with the inputs of its case."""
    results: list[Tensor] = []
    left = iter(inputs)
    for name in NETWORK:
        own = [next(left) if isinstance(one, Tensor) else one for one in CASES[name].inputs]
        results += tensors_of(CASES[name].call(*own))
    return tuple(results)


def in_onnx_runtime(module: nn.Module, inputs: tuple[Any, ...], batches: tuple[int, ...]) -> None:
    """Export a module by torch's plain exporter, with a batch of any size if there are several `batches`, and compare
    the results of ONNX Runtime, of the first frames, with those of the module.
    """
    tensors = [one for one in inputs if isinstance(one, Tensor)]
    is_batch = [one.ndim > 2 for one in tensors]
    axes = [{0: torch.export.Dim("batch")} if one else None for one in is_batch]
    keep_operators()
    program = torch.onnx.export(
        module, inputs, dynamo=True, verbose=False, optimize=len(batches) == 1,  # which is long
        dynamic_shapes=(tuple(axes) + (None,) * (len(inputs) - len(tensors)),) if len(batches) > 1 else None,
    )  # fmt: skip
    assert program is not None
    session = onnxruntime.InferenceSession(program.model_proto.SerializeToString(), providers=["CPUExecutionProvider"])
    for batch in batches:
        given = [one[:batch] if many else one for one, many in zip(tensors, is_batch, strict=True)]
        fed = {one.name: value.numpy() for one, value in zip(session.get_inputs(), given, strict=True)}
        wanted = tensors_of(module(*given, *inputs[len(tensors) :]))
        for result, other in zip(session.run(None, fed), wanted, strict=True):
            torch.testing.assert_close(torch.from_numpy(result), other, rtol=1e-4, atol=1e-4, equal_nan=True)


STANDARD = [name for name in CASES if name in ops.__all__ and name not in BY_DATA]  # no variants: they share the graph


@pytest.mark.long
@pytest.mark.parametrize("name", STANDARD)
def test_ops_run_in_onnx_runtime(name: str) -> None:
    in_onnx_runtime(Exported(CASES[name].call), CASES[name].inputs, (1, 2))


@pytest.mark.long
def test_a_module_of_ops_runs_in_onnx_runtime() -> None:
    inputs = [one for name in NETWORK for one in CASES[name].inputs if isinstance(one, Tensor)]
    in_onnx_runtime(Exported(network), tuple(inputs), (2,))


@pytest.mark.long
@pytest.mark.parametrize("name", ["median_filter", "ContactGraph", "FieldsGraph"])
def test_ops_compiled_by_inductor_agree(name: str) -> None:
    """Results of inductor, which writes loops of its own, agree to the rounding of sums."""
    if shutil.which("g++") is None:
        pytest.skip("no C++ compiler here")
    compiled_as_it_is(name, "inductor", tolerance=1e-4)


@pytest.mark.long
@needs_kernels
@pytest.mark.parametrize("name", ["median_filter", "local_gradients - variance", "track_points", "detect_corners"])
def test_compiled_ops_take_batches_of_any_size(name: str) -> None:
    compiled_as_it_is(name, "aot_eager", dynamic=True)


@pytest.mark.long
def test_derivatives_are_those_of_the_op() -> None:
    """Compiled derivatives are those of the op. If a derivative is wanted the portable form runs and is compiled;
    tracking gives the derivative of a position by its images.
    """
    first, second, points, moved = scene(1)
    images = [image.float().requires_grad_() for image in (first, second)]

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
        name: kernel
        for name, kernel in kernel_calls().items()
        if isinstance(kernel.function, kernels.Twin) or kernel.function in vars(kernels).values()
    }
    return {**own, **passes}


@pytest.mark.long
@needs_kernels
@pytest.mark.parametrize("name", of_kernels() if kernels.serve() else ())
def test_shapes_and_schema_are_true(name: str) -> None:
    function, arguments, settings = of_kernels()[name]
    tests = ("test_schema", "test_faketensor", "test_aot_dispatch_static")
    with torch.no_grad():
        torch.library.opcheck(getattr(torch.ops.fingerflow, function.__name__), arguments, settings, test_utils=tests)


class HostWait(Exception):
    """Wait of the host in a step that reads a value from the accelerator, or copies one to it."""


class Watch(TorchDispatchMode):
    """Dispatch mode that raises `HostWait` where an operation on tensors without values (torch's device `meta`) needs a
    value or mixes them with tensors of the host, and, from the second run on, where a constant is brought anew.
    """

    def __init__(self, first: bool) -> None:
        super().__init__()
        self.first = first

    def __torch_dispatch__(self, operation: Any, types: Any, arguments: Any = (), options: Any = None) -> Any:
        name = operation.name()
        given = [value for value in tree_leaves((arguments, options or {})) if isinstance(value, Tensor)]
        there = any(tensor.is_meta for tensor in given)
        # A scalar of the host is an argument of the call, not a copy.
        mixed = there and any(not tensor.is_meta and tensor.ndim for tensor in given)
        by_mask = name.startswith(("aten::index.", "aten::index_put", "aten::_index_put")) and any(
            isinstance(index, Tensor) and index.dtype == torch.bool for index in arguments[1]
        )
        if there and (mixed or by_mask or name in WAITS):
            raise HostWait(f"{operation}{' by a mask' if by_mask else ' with a tensor of the host' if mixed else ''}")
        result = operation(*arguments, **(options or {}))
        made = any(value.is_meta for value in tree_leaves(result) if isinstance(value, Tensor))
        # `detach_` is the one trace of torch.tensor([...], device=...).
        if not self.first and ((name == "aten::detach_" and there) or (given and made and not there)):
            raise HostWait(f"{operation} brings a constant from the host in every call")
        return result


def run_without_values(module: nn.Module, inputs: tuple[Any, ...]) -> Any:
    """Run a module twice on tensors without values, and return its result; the first run may bring constants, which the
    accelerator keeps.
    """

    def shape_of(value: Any) -> Any:
        return value.to("meta") if isinstance(value, Tensor) else value

    there = {name: shape_of(value) for name, value in (*module.named_parameters(), *module.named_buffers())}
    given = tree_map(shape_of, inputs)
    for first in (True, False):
        with torch.inference_mode(), Watch(first):
            result = torch.func.functional_call(module, there, given)
    return result


class Step(NamedTuple):
    """A module, and a function that returns its inputs."""

    module: nn.Module
    inputs: Callable[[], tuple[Any, ...]]


def step_of(name: str) -> Step:
    """Return a module of the table, or of a shipped recipe, by its name in `STEPS`."""
    if name in MODULES:
        return Step(MODULES[name].call, lambda: MODULES[name].inputs)
    recipe, _, graph = name.partition(" ")
    return steps_of(recipe)[graph]


@functools.cache
def steps_of(recipe: str) -> dict[str, Step]:
    return dict(of_recipe(small(load_recipe(RECIPES[recipe]))))


def small(recipe: Recipe) -> Recipe:
    return replace(
        recipe,
        views=replace(recipe.views, height=HEIGHT, width=WIDTH),
        tracking=replace(recipe.tracking, points=COUNT, window_px=11),
        export=replace(recipe.export, graphs=GRAPHS),
    )


def of_recipe(recipe: Recipe) -> Iterator[tuple[str, Step]]:
    """Yield the graphs of a recipe by name; inputs have the shapes and types of the outputs of earlier graphs."""
    neighbours = torch.zeros(1, NEIGHBOURS, COUNT)
    view = torch.zeros(1, 1, HEIGHT, WIDTH)
    points = torch.zeros(1, COUNT, 2)
    known = {
        **dict.fromkeys(("contact_view", "topography_view", "key_view"), view.to(torch.uint8)),
        **dict.fromkeys(("light", "black"), view),
        "mask": view.to(torch.bool),
        **dict.fromkeys(("warp", "inverse_warp", "gradient", "found_covariance"), torch.zeros(1, COUNT, 2, 2)),
        **dict.fromkeys(("points", "prediction", "start", "found", "reference", "displacement", "queries"), points),
        "gradient_covariance": torch.zeros(1, COUNT, 2, 2, 2, 2),
        **dict.fromkeys(("position_std", "variance"), points[..., 0]),
        "among": points[..., 0].to(torch.bool),
        **dict.fromkeys(("ellipse_center", "ellipse_semi_axes"), torch.ones(1, 2)),
        **dict.fromkeys(("ellipse_angle", "gauge_length", "threshold"), torch.ones(1)),
        **{"neighbour_number": neighbours.int(), "neighbour_within": neighbours},
        "neighbour_offset": torch.zeros(1, NEIGHBOURS, COUNT, 2),
    }
    for name, graph in build_graphs(recipe).items():
        step = Step(graph, lambda given=tuple(known[one] for one in graph.inputs): given)
        yield name, step
        results = run_without_values(step.module, step.inputs())
        computed = {
            one: torch.zeros(value.shape, dtype=value.dtype) for one, value in zip(graph.outputs, results, strict=True)
        }
        known = {**computed, **known}


MODULES = {name: case for name, case in CASES.items() if isinstance(case.call, nn.Module)}
STEPS = (*MODULES, *(f"{recipe} {graph}" for recipe in RECIPES for graph in GRAPHS))


@pytest.mark.long
@pytest.mark.parametrize("name", STEPS)
def test_the_host_never_waits(name: str) -> None:
    step = step_of(name)
    run_without_values(step.module, step.inputs())
