"""Tests that every module of the graphs is ready for an accelerator, without one: the host never waits, the number of
launches does not grow with the recordings, and torch compiles one graph without a break.

A new module needs inputs in tests/embedded.py.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import torch
from torch import Tensor, nn

from bench.launches import HostWait, Launches, count_launches
from fingerflow.export.build import build
from fingerflow.export.recipe import GRAPHS, Recipe, load_recipe
from fingerflow.ops.tracking.outliers import find_neighbours
from tests.embedded import CASES, cases

pytestmark = pytest.mark.long

HEIGHT, WIDTH, POINTS = 96, 128, 40
RECIPES = {path.stem: path for path in sorted((Path(__file__).parents[1] / "export").glob("*.toml"))}


class Step(NamedTuple):
    """A module, and a function that returns its inputs for a number of recordings side by side."""

    module: nn.Module
    inputs: Callable[[int], tuple[Any, ...]]


def images(dtype: torch.dtype = torch.uint8) -> Callable[[int], Tensor]:
    return lambda batch: torch.zeros(batch, 1, HEIGHT, WIDTH, dtype=dtype)


def points(*shape: int) -> Callable[[int], Tensor]:
    return lambda batch: torch.zeros(batch, POINTS, *shape)


def alone(dtype: torch.dtype = torch.float32) -> Callable[[int], Tensor]:
    return lambda batch: torch.zeros(batch, dtype=dtype)


def steps() -> dict[str, Step]:
    """Return all modules by name: those of the graphs (tests/embedded.py) and of the shipped recipes."""
    found = {
        name: Step(case.call, lambda batch, name=name: cases(batch)[name].inputs)
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
    known = {
        **dict.fromkeys(("contact_view", "topography_view", "key_view"), images()),
        **dict.fromkeys(("empty", "dark"), images(torch.float32)),
        "mask": images(torch.bool),
        "threshold": alone(),
        **dict.fromkeys(("warp", "inverse_warp", "gradient", "found_covariance"), points(2, 2)),
        **dict.fromkeys(("points", "prediction", "start", "found", "reference", "displacement", "queries"), points(2)),
        "position_std": points(),
        "among": lambda batch: torch.zeros(batch, POINTS, dtype=torch.bool),
        **dict.fromkeys(("ellipse_center", "ellipse_semi_axes"), lambda batch: torch.ones(batch, 2)),
        "ellipse_angle": alone(),
        "gauge_length": lambda _: torch.ones(1),
        **{
            f"neighbour_{name}": lambda batch, one=one: one.expand(batch, *one.shape[1:]).contiguous()
            for name, one in beside._asdict().items()
        },
    }

    def outcome(step: Step, place: int) -> Callable[[int], Tensor]:
        def of(batch: int) -> Tensor:
            shape, dtype = launches(step, batch).result[place]
            return torch.zeros(shape, dtype=dtype)

        return of

    for name, graph in build(recipe).items():
        step = Step(graph.module, lambda batch, names=graph.inputs: tuple(known[one](batch) for one in names))
        yield name, step
        for place, output in enumerate(graph.outputs):
            known.setdefault(output, outcome(step, place))


STEPS = steps()


@cache
def launches(step: Step, batch: int) -> Launches:
    return count_launches(step.module, step.inputs(batch))


@pytest.mark.parametrize("name", STEPS)
def test_the_host_never_waits_and_more_recordings_cost_no_launch(name: str) -> None:
    one, eight = (launches(STEPS[name], batch).calls for batch in (1, 8))
    assert 0 < one == eight


@pytest.mark.parametrize("name", [name for name in STEPS if name.split()[0] == next(iter(RECIPES))])
def test_compiled_whole(name: str) -> None:
    step = STEPS[name]
    torch.compiler.reset()
    with torch.inference_mode():
        torch.compile(step.module, fullgraph=True, dynamic=False, backend="eager")(*step.inputs(1))


# Tests of the counter itself


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
        count_launches(Formula(WAITING[what]), (torch.ones(3),))


def test_launches_are_counted_and_views_are_not() -> None:
    step = Formula(lambda values: (values[None, :2] * 2 + torch.arange(2, device=values.device)).T.sum())
    assert count_launches(step, (torch.ones(3),))[:2] == (4, ((), torch.float32))
    own = Formula(lambda values: values + step.constant.to("meta"))
    own.formula = lambda values: values + own.constant
    assert count_launches(own, (torch.ones(3),)).calls == 1
