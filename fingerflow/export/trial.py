"""Frames with which an exported graph is tried: the shipped press, sized to the recipe's views, and the hard cases."""

import math
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from fingerflow.export.build import RENEWED, SEARCHED, Graph
from fingerflow.export.recipe import GraphName, Recipe
from fingerflow.ops.entry import MOVED_IN
from fingerflow.synthetic import Camera, Press

_SHIPPED = (512, 640)  # px of the views that the default press is made for
_BORDER = 0.6  # of the contact for the fields, as a share of half the view
_MOVED_IN = 0.1  # within it are points that moved in
_KEY, _FRAME = 180, 183  # of its frames: skin under contact that moves and spreads


class Case(NamedTuple):
    """Inputs of all graphs by their names; what later graphs need is filled in from the results of earlier ones."""

    name: str
    inputs: dict[str, Tensor]


class _Pictures(NamedTuple):
    """Views (H, W) of a press: both of a frame, the topography of the key frame, the contact view without a finger."""

    contact: Tensor
    topography: Tensor
    key: Tensor
    glass: Tensor
    dark: Tensor
    topography_to_contact: Tensor
    mm_per_px: float


def cases(recipe: Recipe, batch: int) -> list[Case]:
    """A press with sub-pixel motion, and frames that are blank, black, saturated, or noise; lost and foreign points."""
    size = (recipe.views.height, recipe.views.width)
    most = 2**recipe.views.bit_depth - 1
    kind = torch.uint8 if recipe.views.bit_depth == 8 else torch.uint16
    generator = torch.Generator().manual_seed(1)

    def view(values: Tensor) -> Tensor:
        return values.to(torch.int32).to(kind).expand(batch, 1, *size).contiguous()

    def flat(light: float) -> Tensor:
        noise = 0.008 * most * torch.randn(size, generator=generator)
        return view((light * most + noise).round().clamp(0, most))

    pictures = _press(*size, recipe.views.bit_depth)
    points = _points(size, recipe.tracking.points).expand(batch, -1, -1).contiguous()
    lost = points.clone()
    lost[:, ::5] = torch.nan
    lost[:, 1::5] = -3.0
    lost[:, 2::5] += 40.0
    radius = _radius(points, size)
    press = {
        "background": pictures.glass.expand(batch, 1, *size).contiguous(),
        "dark": pictures.dark.expand(batch, 1, *size).contiguous(),
        "threshold": torch.full((batch,), 0.27),
        "mask": torch.ones(batch, 1, *size, dtype=torch.bool),
        "topography_to_contact": pictures.topography_to_contact,
        "contact_view": view(pictures.contact),
        "topography_view": view(pictures.topography),
        "key_view": view(pictures.key),
        "points": points,
        "prediction": points,
        "reference": _reference(points, size),
        "reached": (radius < _BORDER - 0.05).to(torch.uint8),
        "covered": (radius < _BORDER).to(torch.uint8),
        "entry": MOVED_IN * (radius < _MOVED_IN).to(torch.uint8),
        "chosen": _reference(points, size) - 5.0,
        "at_entry": (_warp(points) - torch.eye(2)) / 2,
        "warp": _warp(points),
        "mm_per_px": torch.tensor([pictures.mm_per_px]),
        **dict(zip(("center", "semi_axes", "angle"), _ellipse(batch, size), strict=True)),
    }
    noise = view((torch.rand(size, generator=generator) * most).round())
    hard = {"blank": flat(0.5), "black": flat(0.0), "saturated": flat(2.0), "noise": noise}
    return [
        Case("press", press),
        Case("lost and foreign points", {**press, "prediction": lost}),
        Case("points that are none", {**press, "points": lost}),
        *(
            Case(name, {**press, "contact_view": frame, "topography_view": frame, "key_view": frame})
            for name, frame in hard.items()
        ),
        Case("unknown threshold", {**press, "threshold": torch.full((batch,), torch.nan)}),
    ]


def feed(name: GraphName, graph: Graph, known: dict[str, Tensor]) -> tuple[Tensor, ...]:
    """The inputs of a graph, by position; the key frame is a view of its own."""
    source = {**known, "topography_view": known["key_view"]} if name in ("key", "detect") else known
    if name == "renew":
        source = source | {one: source[one][:, :RENEWED] for one in ("points", "warp")}
    if name == "search":
        source = source | {one: source[one][:, :SEARCHED] for one in ("points", "prediction")}
    return tuple(source[one] for one in graph.inputs)


@lru_cache(maxsize=4)
def _press(height: int, width: int, bit_depth: int) -> _Pictures:
    """The default press; where the views are smaller, of a finger as much smaller."""
    scale = min(1.0, height / _SHIPPED[0], width / _SHIPPED[1])
    shipped = Press()
    press = Press(
        frame_shape=(height, 2 * width),
        semi_axes=(scale * shipped.semi_axes[0], scale * shipped.semi_axes[1]),
        finger=(scale * shipped.finger[0], scale * shipped.finger[1]),
        camera=Camera(bit_depth=bit_depth),
    )

    def picture(frame: int, name: str) -> Tensor:
        return torch.from_numpy(press.views[name].crop(press.render(frame)).astype("int32"))

    glass, dark = (
        torch.from_numpy(press.views["contact"].crop(one).astype("float32")) for one in (press.empty(), press.dark())
    )
    matrix = torch.tensor(press.topography_to_contact, dtype=torch.float32)
    return _Pictures(
        picture(_FRAME, "contact"),
        picture(_FRAME, "topography"),
        picture(_KEY, "topography"),
        glass,
        dark,
        matrix,
        press.mm_per_px,
    )


def _radius(points: Tensor, size: tuple[int, int]) -> Tensor:
    """Distance (B, N) of points from the middle of the view, 1 at its sides."""
    return torch.hypot(2 * points[..., 0] / size[1] - 1, 2 * points[..., 1] / size[0] - 1)


def _reference(points: Tensor, size: tuple[int, int]) -> Tensor:
    """Where points were at the onset of contact, if it came to those outside last: spread and turned by some per cent
    since then. NaN where it has not come yet.
    """
    radius = _radius(points, size)[..., None]
    arm = points - torch.tensor([size[1] / 2, size[0] / 2])
    moved = (_BORDER - radius) * (0.2 * arm + 0.05 * torch.stack((-arm[..., 1], arm[..., 0]), dim=-1))
    return torch.where(radius < _BORDER - 0.05, points - moved, torch.nan)


def _warp(points: Tensor) -> Tensor:
    """Deformation gradients (B, N, 2, 2) of some per cent, other ones from point to point."""
    x, y = points[..., 0] / 40, points[..., 1] / 40
    change = torch.stack((torch.sin(x), torch.cos(y), torch.sin(x + y), torch.cos(x - y)), dim=-1)
    result: Tensor = torch.eye(2) + 0.03 * change.unflatten(-1, (2, 2))
    return result


def _ellipse(batch: int, size: tuple[int, int]) -> tuple[Tensor, Tensor, Tensor]:
    """Centre, semi axes (B, 2) and angle (B,) of the contact for the fields, px."""
    half = torch.tensor([size[1] / 2, size[0] / 2]).expand(batch, -1)
    return half.contiguous(), (_BORDER * half).contiguous(), torch.full((batch,), 0.1)


def _points(size: tuple[int, int], count: int) -> Tensor:
    """(1, N, 2) spread over the frame, to its border."""
    columns = math.ceil(math.sqrt(count * size[1] / size[0]))
    number = torch.arange(count)
    rows = -(-count // columns)
    x = (number % columns + 0.5) / columns * (size[1] - 1)
    y = (number // columns + 0.5) / rows * (size[0] - 1)
    return torch.stack((x, y), dim=1)[None]
