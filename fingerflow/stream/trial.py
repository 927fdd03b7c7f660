"""Frames with which an exported graph is tried: skin under a finger that moves, and the hard cases."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from fingerflow.stream.graphs import Graph
from fingerflow.stream.recipe import GraphName, Recipe

_RIDGE_PX = 9.0


class Case(NamedTuple):
    """Inputs of all graphs by their names; what later graphs need is filled in from the results of earlier ones."""

    name: str
    inputs: dict[str, Tensor]


def cases(recipe: Recipe, batch: int) -> list[Case]:
    """A press with sub-pixel motion, and frames that are blank, black, saturated, or noise; lost and foreign points."""
    size = (recipe.views.height, recipe.views.width)
    most = 2**recipe.views.bit_depth - 1
    kind = torch.uint8 if recipe.views.bit_depth == 8 else torch.uint16
    generator = torch.Generator().manual_seed(1)

    def view(values: Tensor) -> Tensor:
        noisy = values * most + 0.008 * most * torch.randn(values.shape, generator=generator)
        return noisy.round().clamp(0, most).to(torch.int32).to(kind).expand(batch, 1, *size).contiguous()

    glass = 0.8 - 0.2 * _radius(size)
    skin, moved = (_skin(size, shift) for shift in ((0.0, 0.0), (0.37, -0.22)))
    ridges = 1 - 0.6 * (_radius(size) < 0.6) * (_ridges(size) > 0)
    blank = torch.full(size, 0.5)
    empty, dark = view(glass).to(torch.float32), torch.zeros(batch, 1, *size)
    points = _points(size, recipe.tracking.points).expand(batch, -1, -1).contiguous()
    lost = points.clone()
    lost[:, ::5] = torch.nan
    lost[:, 1::5] = -3.0
    lost[:, 2::5] += 40.0
    late = _strained(points)
    late[:, ::5] = torch.nan
    matrix = torch.tensor([[0.999, 0.002, 0.4], [-0.002, 0.999, -0.3]])
    common = {
        "background": empty,
        "dark": dark,
        "threshold": torch.full((batch,), 0.28),
        "mask": torch.ones(batch, 1, *size, dtype=torch.bool),
        "topography_to_contact": matrix,
        "reference": _strained(points),
        "reached": torch.isfinite(late[..., 0]).to(torch.uint8),
        "covered": (torch.arange(points.shape[1]) % 7 > 0).to(torch.uint8).expand(batch, -1).contiguous(),
    }
    press = {"contact_view": view(glass * ridges), "topography_view": view(moved), "key_view": view(skin)}
    white = torch.ones(size)
    noise = torch.rand(size, generator=generator)
    return [
        Case("press", {**common, **press, "points": points, "prediction": points}),
        Case("lost and foreign points", {**common, **press, "points": points, "prediction": lost, "reference": late}),
        Case(
            "points that are none",
            {**common, **press, "points": lost, "prediction": points, "reference": _strained(lost)},
        ),
        *(
            Case(
                name,
                {
                    **common,
                    "contact_view": view(values),
                    "topography_view": view(values),
                    "key_view": view(values),
                    "points": points,
                    "prediction": points,
                },
            )
            for name, values in (("blank", blank), ("black", 0 * white), ("saturated", 2 * white), ("noise", noise))
        ),
        Case(
            "unknown threshold",
            {**common, **press, "points": points, "prediction": points, "threshold": torch.full((batch,), torch.nan)},
        ),
    ]


def feed(name: GraphName, graph: Graph, known: dict[str, Tensor]) -> tuple[Tensor, ...]:
    """The inputs of a graph, by position; the key frame is a view of its own."""
    source = {**known, "topography_view": known["key_view"]} if name in ("key", "detect") else known
    return tuple(source[one] for one in graph.inputs)


def _strained(points: Tensor) -> Tensor:
    """Where the points were before a deformation of some per cent."""
    return points - 0.03 * points.flip(2) + 0.05 * points + 0.7 * torch.sin(points / 25)


def _grid(size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    y, x = torch.meshgrid(*(torch.arange(side, dtype=torch.float64) for side in size), indexing="ij")
    return x, y


def _radius(size: tuple[int, int]) -> Tensor:
    """Distance from the middle in half diagonals of an inscribed ellipse."""
    x, y = _grid(size)
    return torch.hypot(2 * x / (size[1] - 1) - 1, 2 * y / (size[0] - 1) - 1)


def _ridges(size: tuple[int, int]) -> Tensor:
    x, y = _grid(size)
    bent = x + 6 * torch.sin(y / 41)
    return torch.sin(2 * math.pi / _RIDGE_PX * (0.8 * bent + 0.6 * y)) + 0.3


def _skin(size: tuple[int, int], shift: tuple[float, float]) -> Tensor:
    x, y = _grid(size)
    x, y = x - shift[0] - 0.002 * x, y - shift[1] + 0.001 * y
    bent = x + 6 * torch.sin(y / 41)
    ridge = torch.sin(2 * math.pi / _RIDGE_PX * (0.8 * bent + 0.6 * y))
    pores = torch.sin(x / 2.3 + torch.sin(y / 9)) * torch.sin(y / 2.9 + torch.sin(x / 7))
    return 0.5 + 0.18 * ridge + 0.14 * pores


def _points(size: tuple[int, int], count: int) -> Tensor:
    """(1, N, 2) spread over the frame, to its border."""
    columns = math.ceil(math.sqrt(count * size[1] / size[0]))
    number = torch.arange(count)
    rows = -(-count // columns)
    x = (number % columns + 0.5) / columns * (size[1] - 1)
    y = (number // columns + 0.5) / rows * (size[0] - 1)
    return torch.stack((x, y), dim=1)[None]
