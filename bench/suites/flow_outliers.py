"""Errors of dense flow at motion edges and under dust: the models of `dense_flow`, and other libraries.

Ridges and whorl of the suite `flow`, 320 x 400 px, 8 bit, noise of 2 grey levels. `jump`: inside an ellipse skin is
stuck, outside it slips by 0.5 or 1.5 px along x; what then hides behind the ellipse is left out. `dust`: 300 specks of
half the light, radii of 1.5 to 3 px, rest in the picture while the skin moves by up to 1.6 px. `epe_px` is the mean
length of the error, `near_px` that within 5 px of the ellipse's border or of a speck, `far_px` that beyond, `div` the
RMS error of the divergence (sigma 8 px) beyond, in 1e-3; 24 px at the border of the picture are left out. Three warps.

`discs` are scenes like photographs: three discs in front of a background, texture of all periods from 5 to 80 px, each
moved by up to 4 px in x and y of its own, stretched and turned by up to 2 %.
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, get_args

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from bench.drawing import BLUE, RED, Mark, cells, draw_dots, saved_axes, scale_by_powers
from bench.rows import Row
from bench.skin import grey, photograph
from bench.suites.flow import NOISE, divergence, inner, opencv, pair, ridges
from fingerflow.ops.flow.dense_flow import dense_flow
from fingerflow.ops.flow.flow_penalty import FlowModel
from fingerflow.synthetic import texture_image

Scene = tuple[Tensor, Tensor, Tensor, Tensor]  # two images, the truth, NaN where there is none, and what is near


def run(quick: bool) -> list[Row]:
    """A row a scene and way."""
    shape, specks = ((160, 200), 150) if quick else ((320, 400), 300)
    scenes: dict[str, Callable[[], Scene]] = {
        "jump of 0.5 px": lambda: jump(shape, 0.5),
        "jump of 1.5 px": lambda: jump(shape, 1.5),
        "dust on ridges": lambda: dust(shape, ridges(), specks),
        "dust on a whorl": lambda: dust(shape, grey, specks),
        "discs": lambda: discs(shape, 0),
        "other discs": lambda: discs(shape, 1),
    }
    rows: list[Row] = []
    for scene, made in scenes.items():
        first, current, truth, near = made()
        for name, found in _found(first, current).items():
            error = (found - truth).norm(dim=1)[0]
            apart = torch.where(near, torch.nan, divergence(found) - divergence(truth.nan_to_num(0.0)))
            rows.append(
                {
                    "scene": scene,
                    "way": name,
                    "epe_px": inner(error).nanmean().item(),
                    "near_px": inner(torch.where(near, error, torch.nan)).nanmean().item(),
                    "far_px": inner(torch.where(near, torch.nan, error)).nanmean().item(),
                    "div": 1e3 * inner(apart).square().nanmean().sqrt().item(),
                }
            )
    return rows


def _found(first: Tensor, current: Tensor) -> dict[str, Tensor]:
    def ours(**settings: Any) -> Tensor:
        return dense_flow(first, current, warps=3, **settings).displacement.double()

    peers = opencv(first[0, 0].numpy(), current[0, 0].numpy())
    return {
        **{name: way() for name, way in peers.items()},
        **{f"fingerflow, {model}": ours(model=model) for model in get_args(FlowModel)},
    }


def _places(shape: tuple[int, int]) -> tuple[Tensor, Tensor]:
    y, x = torch.meshgrid(*(torch.arange(side, dtype=torch.float64) for side in shape), indexing="ij")
    return x, y


def jump(shape: tuple[int, int], slip: float) -> Scene:
    """Skin that sticks inside an ellipse and slips by so many px outside."""
    height, width = shape

    def inside(x: Tensor, y: Tensor) -> Tensor:
        return ((x - width / 2) / (0.3 * width)) ** 2 + ((y - height / 2) / (0.32 * height)) ** 2 < 1

    def material(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        return torch.where(inside(x, y), x, x - slip), y

    texture = ridges()
    clean = texture_image(texture, shape, 1.0), texture_image(texture, shape, 1.0, material)
    first, current = (photograph(one, NOISE, seed) for seed, one in enumerate(clean))
    x, y = _places(shape)
    stuck = inside(x, y)
    along = torch.where(stuck, 0.0, slip)
    along = torch.where(~stuck & inside(x + slip, y), torch.nan, along)
    to_border = sum(cv2.distanceTransform(side.numpy().astype(np.uint8), cv2.DIST_L2, 5) for side in (stuck, ~stuck))
    return first, current, torch.stack((along, 0 * x))[None], torch.as_tensor(to_border) <= 5


def discs(shape: tuple[int, int], seed: int) -> Scene:
    """Three discs that move before a background, each by an affine motion of its own."""
    height, width = shape
    random = np.random.default_rng(seed)
    x, y = _places(shape)
    truth, near = torch.zeros(1, 2, *shape, dtype=torch.float64), torch.zeros(shape, dtype=torch.bool)
    first, current = torch.zeros_like(x), torch.zeros_like(x)
    for k in range(4):
        centre = torch.tensor(random.uniform(0.2, 0.8, 2) * (width, height))[:, None, None]
        radius = math.inf if k == 0 else random.uniform(0.12, 0.28) * height
        shift = torch.tensor(random.uniform(-4, 4, 2))[:, None, None]
        matrix = torch.eye(2, dtype=torch.float64) + torch.tensor(random.uniform(-0.02, 0.02, (2, 2)))
        texture = ridges(300, 5.0, 80.0, seed=100 * seed + k)
        here = torch.stack((x, y)) - centre
        before = torch.einsum("ij,jhw->ihw", torch.linalg.inv(matrix), here - shift)
        first, current = (
            torch.where(at.norm(dim=0) < radius, texture(*(at + centre)), under)
            for at, under in ((here, first), (before, current))
        )
        moved = torch.einsum("ij,jhw->ihw", matrix, here) + shift - here
        truth = torch.where(here.norm(dim=0) < radius, moved, truth)
        near = (near & (here.norm(dim=0) >= radius)) | ((here.norm(dim=0) - radius).abs() <= 5)
    first, current = (photograph(one[None, None], NOISE, number) for number, one in enumerate((first, current)))
    return first, current, truth, near


def dust(shape: tuple[int, int], texture: Callable[[Tensor, Tensor], Tensor], count: int) -> Scene:
    """Skin that moves behind so many specks."""
    first, current, truth = pair(texture, shape)
    x, y = _places(shape)
    light = torch.ones(shape, dtype=torch.float64)
    specks = torch.rand(count, 3, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    for right, down, wide in specks.tolist():
        square = ((x - right * shape[1]) ** 2 + (y - down * shape[0]) ** 2) / (1.5 + 1.5 * wide) ** 2
        light *= 1 - 0.5 * torch.exp(-square * square)
    near = functional.max_pool2d((light < 0.9).double()[None, None], 11, 1, 5)[0, 0] > 0
    first, current = ((one * light).round().clamp(0, 255).to(torch.uint8) for one in (first, current))
    return first, current, truth, near


_MARKS = {
    "fingerflow, auto": Mark(RED),
    "fingerflow, charbonnier": Mark(RED, filled=False),
    "opencv DIS, medium": Mark(BLUE, "s"),
    "opencv Farneback": Mark(BLUE, "s", filled=False),
}
_PANELS = {"near_px": "within 5 px of an edge or speck", "far_px": "beyond"}


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw the error near edges or specks, and away from them, a row per scene."""
    scenes = list(dict.fromkeys(str(row["scene"]) for row in rows))
    with saved_axes(path, 2.8, 2, sharey=True) as panels:
        for axes, (column, where) in zip(panels, _PANELS.items(), strict=True):
            values = {way: cells(rows, column, "scene", scenes, way=way) for way in _MARKS}
            draw_dots(axes, scenes, values, _MARKS)
            scale_by_powers(axes.xaxis)
            axes.set_title(where, fontsize=10)
            axes.set_xlabel("mean length of the error (px)")
        panels[1].legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
