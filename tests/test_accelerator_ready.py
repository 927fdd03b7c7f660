"""Tests that every module of the graphs is ready for an accelerator, without one: the host never waits for it, and
torch compiles one graph without a break.

A new module needs inputs in tests/embedded.py.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import torch
from torch import Tensor, nn
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

from fingerflow.export.build import build_graphs
from fingerflow.export.recipe import GRAPHS, Recipe, load_recipe
from fingerflow.ops.tracking.outliers import find_neighbours
from tests.embedded import CASES

pytestmark = pytest.mark.long

HEIGHT, WIDTH, POINTS = 96, 128, 40
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


def steps() -> dict[str, Step]:
    """Return all modules by name: those of the graphs (tests/embedded.py) and of the shipped recipes."""
    found = {
        name: Step(case.call, lambda case=case: case.inputs)
        for name, case in CASES.items()
        if isinstance(case.call, nn.Module)
    }
    for recipe, path in RECIPES.items():
        found |= {f"{recipe} {name}": step for name, step in of_recipe(small(load_recipe(path)))}
    return found


def small(recipe: Recipe) -> Recipe:
    return replace(
        recipe,
        views=replace(recipe.views, height=HEIGHT, width=WIDTH),
        tracking=replace(recipe.tracking, points=POINTS, window_px=11),
        export=replace(recipe.export, graphs=GRAPHS),
    )


def of_recipe(recipe: Recipe) -> Iterator[tuple[str, Step]]:
    """Yield the graphs of a recipe by name; inputs have the shapes and types of the outputs of earlier graphs."""
    beside = find_neighbours(torch.rand(1, POINTS, 2, generator=torch.Generator().manual_seed(0)), 1.0)
    view = torch.zeros(1, 1, HEIGHT, WIDTH)
    points = torch.zeros(1, POINTS, 2)
    known = {
        **dict.fromkeys(("contact_view", "topography_view", "key_view"), view.to(torch.uint8)),
        **dict.fromkeys(("empty", "dark"), view),
        "mask": view.to(torch.bool),
        **dict.fromkeys(("warp", "inverse_warp", "gradient", "found_covariance"), torch.zeros(1, POINTS, 2, 2)),
        **dict.fromkeys(("points", "prediction", "start", "found", "reference", "displacement", "queries"), points),
        "position_std": points[..., 0],
        "among": points[..., 0].to(torch.bool),
        **dict.fromkeys(("ellipse_center", "ellipse_semi_axes"), torch.ones(1, 2)),
        **dict.fromkeys(("ellipse_angle", "gauge_length", "threshold"), torch.ones(1)),
        **{f"neighbour_{name}": one for name, one in beside._asdict().items()},
    }
    for name, graph in build_graphs(recipe).items():
        step = Step(graph.module, lambda given=tuple(known[one] for one in graph.inputs): given)
        yield name, step
        results = run_without_values(step.module, step.inputs())
        computed = {
            one: torch.zeros(value.shape, dtype=value.dtype) for one, value in zip(graph.outputs, results, strict=True)
        }
        known = {**computed, **known}


STEPS = steps()


@pytest.mark.parametrize("name", STEPS)
def test_the_host_never_waits(name: str) -> None:
    run_without_values(STEPS[name].module, STEPS[name].inputs())


@pytest.mark.parametrize("name", [name for name in STEPS if name.split()[0] == next(iter(RECIPES))])
def test_compiled_whole(name: str) -> None:
    step = STEPS[name]
    torch.compiler.reset()
    with torch.inference_mode():
        torch.compile(step.module, fullgraph=True, dynamic=False, backend="eager")(*step.inputs())


# Tests of the test


class Formula(nn.Module):
    def __init__(self, formula: Callable[[Tensor], Any]) -> None:
        super().__init__()
        self.formula = formula
        self.register_buffer("constant", torch.arange(3.0))

    def forward(self, values: Tensor) -> Any:
        return self.formula(values)


WAITING: dict[str, Callable[[Tensor], Any]] = {
    "a number": lambda values: values * float(values.sum()),
    "a choice": lambda values: values if values.any() else -values,
    "a mask": lambda values: values[values > 0],
    "places": lambda values: values.nonzero(),
    "writing by a mask": lambda values: values.clone().index_put_((values > 0,), values.sum()),
    "a constant of the host": lambda values: values + torch.arange(3.0),
    "a constant that is brought": lambda values: values + torch.arange(3.0).to(values.device),
    "numbers": lambda values: values + torch.tensor([1.0, 2.0, 3.0], device=values.device),
    "other numbers": lambda values: values + values.new_tensor([1.0, 2.0, 3.0]),
    "counts": lambda values: torch.bincount(values.long()),
    "repeats": lambda values: values.repeat_interleave(values.long()),
}


@pytest.mark.parametrize("what", WAITING)
def test_waiting_is_noticed(what: str) -> None:
    with pytest.raises(HostWait):
        run_without_values(Formula(WAITING[what]), (torch.ones(3),))


def test_constants_of_the_module_are_kept() -> None:
    own = Formula(lambda values: values + own.constant)
    run_without_values(own, (torch.ones(3),))
