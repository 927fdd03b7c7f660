"""Errors of dense optical flow on skin at every pixel, and of the divergence computed from it.

Views of 480 x 640 px (smaller with --quick), 8 bit, noise of 2 grey levels; a smooth field of up to 1.6 px, four waves
of 200 to 400 px. `whorl` is the skin of the other suites, one direction of ridges in most places, 15 px apart; `ridges`
runs in all directions, 9 to 22 px apart. `epe_px` is the mean length of the error, `div` the RMS error of the
divergence of the field smoothed with sigma 8 px, in 1e-3; 24 px of border are left out, as the peers know nothing
there. `z` is the RMS of the error over the stated deviation.

`cold` prepares the first image and starts from nothing, two warps at each size; `warm` has it prepared and begins with
nine tenths of what was found, with one warp, as frame after frame of a recording.

`dimetrodon` is a real pair with its true flow (Middlebury; where `../shared/data` is): up to 4.3 px, with edges of
motion, by the defaults: `epe_px`, and `angle_deg` the mean angular error, over the pixels that every way knows, and the
time of a call. There variational peers run too, as they come but for what their names say: OpenCV's variational
refinement of DIS, with its gradient term and without, DeepFlow, which matches descriptors besides, and TV-L1.
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from matplotlib.lines import Line2D
from skimage.registration import optical_flow_ilk
from torch import Tensor

from bench.drawing import BLUE, RED, VIOLET, Mark, saved_axes, scale_by_powers
from bench.rows import Row, number
from bench.skin import Texture, grey, photograph_motion
from bench.timing import time_in_turns
from fingerflow.ops.flow.dense_flow import Flow, dense_flow, find_flow, prepare_flow

DATA = Path(__file__).resolve().parents[3] / "shared/data/flow"
NOISE, BORDER, SIGMA = 2.0, 24, 8.0
PEER = "opencv Farneback"
Way = Callable[[], Tensor]


def run(quick: bool) -> list[Row]:
    """A row a scene and way."""
    shape = (160, 200) if quick else (480, 640)
    rows: list[Row] = []
    for scene, texture in (("whorl", grey), ("ridges", ridges())):
        first, current, truth = pair(texture, shape)
        ways, flow = _ways(first, current)
        times = time_in_turns(ways, PEER, rounds=2 if quick else 7)
        for name, way in ways.items():
            found = way()
            rows.append(
                {
                    "scene": scene,
                    "way": name,
                    "epe_px": _inner((found - truth).norm(dim=1)).nanmean().item(),
                    "div": 1e3 * _inner(_divergence(found) - _divergence(truth)).square().nanmean().sqrt().item(),
                    "z": _z(flow, truth) if name == "fingerflow, cold" else None,
                    **times[name].cells(),
                }
            )
    return rows + _dimetrodon()


def ridges(count: int = 300, least: float = 9.0, most: float = 22.0) -> Texture:
    """Grey level at real positions in px: waves of 9 to 22 px, or `least` to `most`, in all directions."""
    generator = torch.Generator().manual_seed(3)
    period, angle, phase = torch.rand(3, count, generator=generator, dtype=torch.float64)
    turn = 2 * math.pi / (least + (most - least) * period)
    waves = torch.stack((turn * (2 * math.pi * angle).cos(), turn * (2 * math.pi * angle).sin(), 2 * math.pi * phase))

    def level(x: Tensor, y: Tensor) -> Tensor:
        total = torch.zeros_like(x)
        for right, down, begin in waves.T.tolist():
            total += torch.cos(right * x + down * y + begin)
        return 110 + 40 * total / math.sqrt(count / 2)

    return level


def _motion(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Displacement (u, v) px of what is at (x, y) in the first image."""
    generator = torch.Generator().manual_seed(7)
    along_x, along_y = torch.zeros_like(x), torch.zeros_like(x)
    for angle, period, first, second in torch.rand(4, 4, generator=generator, dtype=torch.float64).tolist():
        turn = 2 * math.pi / (200 + 200 * period)
        phase = turn * (math.cos(2 * math.pi * angle) * x + math.sin(2 * math.pi * angle) * y)
        along_x += 0.5 * torch.sin(phase + 2 * math.pi * first)
        along_y += 0.5 * torch.sin(phase + 2 * math.pi * second)
    return along_x, along_y


def pair(texture: Texture, shape: tuple[int, int]) -> tuple[Tensor, Tensor, Tensor]:
    """Both images of a texture that moves, and its displacement (1, 2, H, W) px."""
    y, x = torch.meshgrid(*(torch.arange(side, dtype=torch.float64) for side in shape), indexing="ij")
    return *photograph_motion(texture, _motion, shape, NOISE), torch.stack(_motion(x, y))[None]


def _ways(first: Tensor, current: Tensor) -> tuple[dict[str, Way], Flow]:
    one, other = first[0, 0].numpy(), current[0, 0].numpy()
    template, found = prepare_flow(first), dense_flow(first, current)
    before = 0.9 * found.displacement

    def ilk() -> Tensor:
        down, right = optical_flow_ilk(one, other, radius=10, dtype=np.float32)
        return _field(np.stack((right, down), axis=-1))

    ways: dict[str, Way] = {
        **_opencv(one, other),
        "scikit-image ILK": ilk,
        "fingerflow, cold": lambda: dense_flow(first, current).displacement.double(),
        "fingerflow, warm": lambda: find_flow(template, current, before, warps=1).displacement.double(),
    }
    return ways, found


def _field(flow: np.ndarray) -> Tensor:
    """(1, 2, H, W) of (H, W, 2)."""
    return torch.from_numpy(np.moveaxis(flow, 2, 0).astype(np.float64))[None]


def _opencv(first: Any, current: Any) -> dict[str, Way]:
    """Fields (1, 2, H, W) of two images (H, W) uint8."""
    farneback: Any = cv2.calcOpticalFlowFarneback  # stubs do not know that there may be no initial flow
    medium: Any = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    return {
        PEER: lambda: _field(farneback(first, current, None, 0.5, 4, 21, 3, 7, 1.5, 0)),
        "opencv DIS, medium": lambda: _field(medium.calc(first, current, None)),
    }


def _variational(first: Any, current: Any) -> dict[str, Way]:
    optflow: Any = cv2.optflow  # unknown to stubs

    def refined(of_gradient: float) -> Tensor:
        refinement: Any = cv2.VariationalRefinement.create()
        refinement.setFixedPointIterations(20)
        refinement.setSorIterations(20)
        refinement.setGamma(of_gradient)
        medium: Any = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        return _field(refinement.calc(first, current, medium.calc(first, current, None)))

    return {
        "opencv DIS, refined by grey levels": lambda: refined(0.0),
        "opencv DIS, refined by gradients too": lambda: refined(10.0),
        "opencv DeepFlow": lambda: _field(optflow.createOptFlow_DeepFlow().calc(first, current, None)),
        "opencv TV-L1": lambda: _field(optflow.createOptFlow_DualTVL1().calc(first, current, None)),
    }


def _dimetrodon() -> list[Row]:
    if not DATA.is_dir():
        return []
    one, other = (cv2.imread(str(DATA / f"dimetrodon_frame{number}.png"), cv2.IMREAD_GRAYSCALE) for number in (10, 11))
    raw = np.fromfile(DATA / "dimetrodon_flow10.flo", np.float32)
    width, height = np.frombuffer(raw[1:3].tobytes(), np.int32)
    truth = _field(raw[3:].reshape(height, width, 2))
    first, current = (torch.from_numpy(image)[None, None] for image in (one, other))

    ways: dict[str, Way] = {
        **_opencv(one, other),
        **_variational(one, other),
        "fingerflow, default": lambda: dense_flow(first, current).displacement.double(),
        "fingerflow, quadratic": lambda: dense_flow(first, current, model="quadratic").displacement.double(),
    }
    times = time_in_turns(ways, PEER, rounds=2)
    rows: list[Row] = []
    fields = {name: way() for name, way in ways.items()}
    known = truth.abs().amax(1) < 1e9
    counted = known & torch.cat(list(fields.values())).isfinite().all(1).all(0)
    for name, found in fields.items():
        length = ((1 + found.square().sum(1)) * (1 + truth.square().sum(1))).sqrt()
        angle = ((1 + (found * truth).sum(1)) / length).clamp(-1, 1).arccos().rad2deg()
        rows.append(
            {
                "scene": "dimetrodon",
                "way": name,
                "epe_px": float((found - truth).norm(dim=1)[counted].mean()),
                "angle_deg": float(angle[counted].mean()),
                **times[name].cells(),
            }
        )
    return rows


def _inner(field: Tensor) -> Tensor:
    return field[..., BORDER:-BORDER, BORDER:-BORDER]


def _divergence(flow: Tensor) -> Tensor:
    """(1, H, W) of the field smoothed with sigma 8 px; what is not known at the border is taken from beside it."""
    planes = [cv2.GaussianBlur(plane.nan_to_num(0.0).numpy(), (0, 0), SIGMA) for plane in flow[0]]
    return torch.from_numpy(np.gradient(planes[0], axis=1) + np.gradient(planes[1], axis=0))[None]


def _z(flow: Flow, truth: Tensor) -> float:
    variance = torch.stack((flow.covariance[:, 0, 0], flow.covariance[:, 1, 1]), dim=1)
    return float(_inner((flow.displacement - truth).square() / variance).nanmean().sqrt())


_MARKS = {"fingerflow": Mark(RED), "opencv": Mark(BLUE, "s"), "scikit-image": Mark(VIOLET, "^")}


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw the error against the time over Farneback's, a panel per scene."""
    scenes = list(dict.fromkeys(str(row["scene"]) for row in rows))
    with saved_axes(path, 3.4, len(scenes), width=10) as panels:
        for axes, scene in zip(panels, scenes, strict=True):
            for row in (row for row in rows if row["scene"] == scene):
                program, _, way = str(row["way"]).partition(" ")
                place = number(row, "time_to_peer"), number(row, "epe_px")
                axes.plot(*place, linestyle="", **_MARKS[program.rstrip(",")].style)
                label = way.replace("refined by ", "").replace(" too", "")
                above = 6 if program == "opencv" else -11
                axes.annotate(label, place, (0, above), textcoords="offset points", ha="center", fontsize=7)
            axes.margins(0.2)
            scale_by_powers(axes.xaxis)
            scale_by_powers(axes.yaxis)
            axes.tick_params(labelsize=8)
            axes.set_title(scene, fontsize=10)
            axes.set_xlabel("time over Farneback's")
        panels[0].set_ylabel("mean length of the error (px)")
        panels[0].legend(handles=[Line2D([], [], ls="", label=name, **mark.style) for name, mark in _MARKS.items()])
