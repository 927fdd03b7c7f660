"""Every module of the graphs on an accelerator that is not there: no wait for the host, launches that do not grow with
the recordings, one graph without a break.

A module that is new has to be given inputs here: `test_every_module_is_tried` names it.
"""

import importlib
import inspect
import pkgutil
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import pytest
import torch
from torch import Tensor, nn

import fingerflow.graphs
from bench.launches import HostWait, Launches, count_launches
from fingerflow.export.build import build
from fingerflow.export.recipe import GRAPHS, Recipe, load_recipe
from fingerflow.graphs import ContactGraph, FieldsGraph, GrossEllipse, KeyGraph, LightGraph, TrackGraph
from fingerflow.graphs.track import AgreementGraph, DeformationGraph
from fingerflow.kernels.tracking_limits import NUMBERS
from fingerflow.ops.tracking.outliers import Neighbours, find_neighbours
from fingerflow.ops.tracking.templates import Found

pytestmark = pytest.mark.long

HEIGHT, WIDTH, POINTS = 96, 128, 40
RECIPES = {path.stem: path for path in sorted((Path(__file__).parents[1] / "export").glob("*.toml"))}


class Step(NamedTuple):
    """A module, and its inputs for so many recordings side by side."""

    module: nn.Module
    inputs: Callable[[int], tuple[Any, ...]]


def images(dtype: torch.dtype = torch.uint8) -> Callable[[int], Tensor]:
    return lambda batch: torch.zeros(batch, 1, HEIGHT, WIDTH, dtype=dtype)


def points(*shape: int) -> Callable[[int], Tensor]:
    return lambda batch: torch.zeros(batch, POINTS, *shape)


def alone(dtype: torch.dtype = torch.float32) -> Callable[[int], Tensor]:
    return lambda batch: torch.zeros(batch, dtype=dtype)


def alone_points(*shape: int) -> Callable[[int], Tensor]:
    """Of the key frame, the same for all."""
    return lambda _: torch.zeros(1, POINTS, *shape)


def templates(key: nn.Module) -> Callable[[int], Any]:
    """As the key graph gives them."""

    def of(batch: int) -> Any:
        shapes = count_launches(key, (images()(batch), points(2)(batch))).result
        return type(shapes)(*(None if one is None else torch.zeros(one[0], dtype=one[1]) for one in shapes))

    return of


def neighbours(_: int) -> Neighbours:
    return find_neighbours(torch.rand(1, POINTS, 2, generator=torch.Generator().manual_seed(0)), 1.0)


def found_points(batch: int) -> Found:
    status = torch.zeros(batch, POINTS, dtype=torch.uint8)
    return Found(points(2)(batch), points()(batch), points(2, 2)(batch), status, points(2)(batch))


def ellipse(batch: int) -> GrossEllipse:
    return GrossEllipse(torch.zeros(batch, 2), torch.ones(batch, 2), torch.zeros(batch))


def steps() -> dict[str, Step]:
    """All modules by name: of the graphs, and of the recipes that are shipped."""

    def step(module: nn.Module, *inputs: Callable[[int], Any]) -> Step:
        return Step(module, lambda batch: tuple(one(batch) for one in inputs))

    glass = images(torch.float32)
    found = {
        "light": step(LightGraph(), glass, glass, alone()),
        "contact": step(ContactGraph(), images(), glass, glass, alone()),
        "key": step(KeyGraph(11), images(), points(2)),
        "key with warps": step(KeyGraph(11, gain_offset=False), images(), points(2), alone(), points(2, 2)),
        "track": step(TrackGraph(), templates(KeyGraph(11)), images(), points(2)),
        "agreement": step(AgreementGraph(), neighbours, alone_points(2), points(2), points()),
        "deformation": step(
            DeformationGraph(11), alone_points(2), found_points, alone_points(NUMBERS), alone_points(2, 2)
        ),
        "fields": step(FieldsGraph(30.0), points(2), points(2), points(2, 2)),
        "fields and medians": step(FieldsGraph(30.0), points(2), points(2), points(2, 2), ellipse),
    }
    for recipe, path in RECIPES.items():
        found |= {f"{recipe} {name}": step for name, step in of_recipe(small(load_recipe(path)))}
    return found


def small(recipe: Recipe) -> Recipe:
    views = recipe.views.model_copy(update={"height": HEIGHT, "width": WIDTH})
    tracking = recipe.tracking.model_copy(update={"points": POINTS, "window_px": 11})
    every = recipe.export.model_copy(update={"graphs": GRAPHS})
    return recipe.model_copy(update={"views": views, "tracking": tracking, "export": every})


def of_recipe(recipe: Recipe) -> Iterator[tuple[str, Step]]:
    """The graphs of a recipe; what one gives the next ones take, in shape and type."""
    beside = neighbours(1)
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

_BROUGHT = "a constant is made in every call"
_ONE_BY_ONE = "views are warped one after the other"
_PICKED = "the neighbours of one recording are picked in one call, those of several one after the other"
_CUT_ONE_BY_ONE = "windows are cut out of one view after the other"
#: What the modules do not meet yet, by step: the tests say when they do.
WAITS = {
    "key with warps": _ONE_BY_ONE,
    "fields and medians": _BROUGHT,
    **{f"{recipe} fields": _BROUGHT for recipe in RECIPES},
    **{f"{recipe} {name}": _BROUGHT for recipe in RECIPES for name in ("fields_entered", "windows")},
    **{f"{recipe} outliers": _PICKED for recipe in RECIPES},
    **{f"{recipe} renew": _ONE_BY_ONE for recipe in RECIPES},
    **{f"{recipe} search": _CUT_ONE_BY_ONE for recipe in RECIPES},
}


@cache
def launches(step: Step, batch: int) -> Launches:
    return count_launches(step.module, step.inputs(batch))


def marked(reasons: dict[str, str], raises: tuple[type[Exception], ...], names: Iterable[str] = STEPS) -> list[Any]:
    """Steps; those that are known to fail, and why, so that they are noticed when they do no longer."""
    return [
        pytest.param(name, marks=pytest.mark.xfail(reason=reasons[name], raises=raises, strict=True))
        if name in reasons
        else name
        for name in names
    ]


def modules_in(package: ModuleType) -> set[type[nn.Module]]:
    """All module classes of a package that do not say by an underscore that they are a part of another."""
    files = [
        importlib.import_module(f"{package.__name__}.{found.name}") for found in pkgutil.iter_modules(package.__path__)
    ]
    return {
        kind
        for file in files
        for name, kind in inspect.getmembers(file, inspect.isclass)
        if issubclass(kind, nn.Module) and kind.__module__ == file.__name__ and not name.startswith("_")
    }


def test_every_module_is_tried() -> None:
    tried = {type(part) for step in STEPS.values() for part in step.module.modules()}
    wanted = modules_in(fingerflow.graphs)
    assert wanted
    assert not {kind.__qualname__ for kind in wanted - tried}, "give these inputs in `steps`"


@pytest.mark.parametrize("name", marked(WAITS, (HostWait, AssertionError)))
def test_the_host_never_waits_and_more_recordings_cost_no_launch(name: str) -> None:
    one, eight = (launches(STEPS[name], batch).calls for batch in (1, 8))
    assert 0 < one == eight


@pytest.mark.parametrize("name", [name for name in STEPS if name.split()[0] not in RECIPES])
def test_traced_whole(name: str) -> None:
    """All of a step in one graph of fixed shapes; those of recipes are exported in tests/export."""
    step = STEPS[name]
    given = step.inputs(1)
    program = torch.export.export(step.module.eval(), given)
    assert not [node for node in program.graph.nodes if "higher_order" in str(node.target)]


@pytest.mark.parametrize("name", [name for name in STEPS if name.split()[0] not in list(RECIPES)[1:]])
def test_compiled_whole(name: str) -> None:
    step = STEPS[name]
    torch.compiler.reset()
    with torch.inference_mode():
        torch.compile(step.module, fullgraph=True, dynamic=False, backend="eager")(*step.inputs(1))


# The counter itself


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
    assert count_launches(step, (torch.ones(3),)) == (4, ((), torch.float32))
    own = Formula(lambda values: values + step.constant.to("meta"))
    own.formula = lambda values: values + own.constant
    assert count_launches(own, (torch.ones(3),)).calls == 1
