"""Every public op and every module of the graphs with inputs of a small scene, as a pipeline calls them.

A new op or module needs inputs here: `without_a_case` names those that have none.
"""

import importlib
import inspect
import pkgutil
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

import fingerflow.graphs
from fingerflow import graphs, ops

HEIGHT, WIDTH, POINTS = 64, 80, 24


class Case(NamedTuple):
    """A function or module, and its inputs."""

    call: Callable[..., Any]
    inputs: tuple[Any, ...]


def scene(batch: int = 2) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return waves as uint8 (B, 1, H, W), the same waves half a pixel further, points (B, N, 2) px, and displacements
    of the points.
    """
    y, x = torch.meshgrid(
        torch.arange(HEIGHT, dtype=torch.float64), torch.arange(WIDTH, dtype=torch.float64), indexing="ij"
    )
    frames = []
    # Forty waves with periods from 6 px on, so that no pattern repeats within a search.
    waves = torch.rand(3, 40, 1, 1, generator=torch.Generator().manual_seed(1), dtype=torch.float64) * 2 - 1
    for shift in (0.0, 0.5):
        ridges = torch.sin(waves[0] * (x - shift) + waves[1] * y + 9 * waves[2]).sum(0)
        frame = (110 + 14 * ridges).round().clamp(0, 255).to(torch.uint8)
        frames.append(frame.expand(batch, 1, HEIGHT, WIDTH))
    generator = torch.Generator().manual_seed(0)
    inside = torch.tensor([WIDTH - 32.0, HEIGHT - 32.0], dtype=torch.float32)
    points = 16 + inside * torch.rand(batch, POINTS, 2, generator=generator, dtype=torch.float32)
    moved = torch.rand(batch, POINTS, 2, generator=generator, dtype=torch.float32) / 10 + points / 50
    return frames[0].contiguous(), frames[1].contiguous(), points, moved


def cases(batch: int = 2) -> dict[str, Case]:
    """Return the cases by name: for ops the public name, and after a dash the variant."""
    first, second, points, moved = scene(batch)
    gray = first.to(torch.float32)
    glass, black = torch.full_like(gray, 200.0), torch.zeros_like(gray)
    one = torch.ones(len(first), dtype=torch.float32)
    triangles = torch.tensor([[0, 1, 2], [3, 4, 5], [6, 7, 8]])
    gradient = ops.local_gradients(points, moved, gauge_length=60.0).gradient
    covariance = torch.eye(2, dtype=torch.float32).expand(len(first), POINTS, 2, 2).contiguous() / 100
    axis_x, axis_y = (torch.arange(16, end, 8, dtype=torch.float32) for end in (WIDTH - 16, HEIGHT - 16))
    key = graphs.KeyGraph(11)
    templates = key(first, points)
    track = graphs.TrackGraph()
    ellipse = graphs.FrameEllipse(
        torch.tensor([[40.0, 32.0]], dtype=torch.float32).repeat(len(first), 1),
        torch.tensor([[20.0, 16.0]], dtype=torch.float32).repeat(len(first), 1),
        torch.zeros(len(first), dtype=torch.float32),
    )
    straight = torch.eye(2, dtype=torch.float32).expand_as(covariance)
    entered = graphs.EnteredPoints(points[..., 0] > 40, gradient / 10, None)
    return {
        "curl": Case(ops.curl, (gradient,)),
        "dense_flow": Case(ops.dense_flow, (first, second)),
        "detect_corners": Case(ops.detect_corners, (first, 20)),
        "detect_corners - floating": Case(ops.detect_corners, (gray, 20)),
        "divergence": Case(ops.divergence, (gradient,)),
        "green_lagrange": Case(ops.green_lagrange, (gradient,)),
        "local_gradients": Case(
            lambda points, values: ops.local_gradients(points, values, gauge_length=60.0), (points, moved)
        ),
        "local_gradients - variance": Case(
            lambda points, values, variance: ops.local_gradients(points, values, gauge_length=60.0, variance=variance),
            (points, moved, covariance),
        ),
        "median_filter": Case(ops.median_filter, (first, 5)),
        "median_filter - large": Case(ops.median_filter, (first, 13)),
        "median_filter - floating": Case(ops.median_filter, (gray, 5)),
        "normalize_illumination": Case(ops.normalize_illumination, (first, glass)),
        "otsu_threshold": Case(ops.otsu_threshold, (first,)),
        "otsu_threshold - floating": Case(
            lambda frames: ops.otsu_threshold(frames, value_range=(-1.0, 255.0)), (gray,)
        ),
        "scattered_to_grid": Case(ops.scattered_to_grid, (points, moved, axis_x, axis_y, 60.0)),
        "strain_energy_density": Case(
            lambda gradient: ops.strain_energy_density(ops.green_lagrange(gradient)), (gradient,)
        ),
        "track_points": Case(lambda *images: ops.track_points(*images, window=11), (first, second, points)),
        "track_points - search": Case(
            lambda *images: ops.track_points(*images, window=11, search=12), (first, second.roll(6, 3), points)
        ),
        "triangle_gradients": Case(ops.triangle_gradients, (points, triangles, moved)),
        "MedianFilter": Case(graphs.MedianFilter(5), (first,)),
        "NormalizeIllumination": Case(graphs.NormalizeIllumination(glass[:1]), (first,)),
        "ContactGraph": Case(graphs.ContactGraph(), (first, glass, black, one * 0.55)),
        "KeyGraph": Case(key, (first, points)),
        "KeyGraph - warp": Case(graphs.KeyGraph(11, gain_offset=False), (first, points, one, straight)),
        "TrackGraph": Case(track, (templates, second, points)),
        "FieldsGraph": Case(graphs.FieldsGraph(60.0), (points, moved, covariance)),
        "FieldsGraph - medians": Case(graphs.FieldsGraph(60.0), (points, moved, covariance, ellipse)),
        "FieldsGraph - entered": Case(graphs.FieldsGraph(60.0), (points, moved, None, ellipse, entered)),
        "DetectGraph": Case(
            graphs.DetectGraph(POINTS, window_px=11), (first, torch.ones_like(first, dtype=torch.bool))
        ),
    }


def without_a_case() -> set[str]:
    """Return the names of public ops and modules that are not in `cases`; graphs of recipes are cases by themselves."""
    files = [
        importlib.import_module(f"fingerflow.graphs.{found.name}")
        for found in pkgutil.iter_modules(fingerflow.graphs.__path__)
    ]
    modules = {
        name
        for file in files
        for name, kind in inspect.getmembers(file, inspect.isclass)
        if issubclass(kind, nn.Module) and kind.__module__ == file.__name__ and not name.startswith("_")
    }
    return (set(ops.__all__) | modules) - {"Graph", *(name.partition(" ")[0] for name in CASES)}


def tensors_of(result: Any) -> list[Tensor]:
    """Return all tensors of a result, in order."""
    if isinstance(result, Tensor):
        return [result]
    return [tensor for part in result or () for tensor in tensors_of(part)] if isinstance(result, tuple) else []


@cache
def expected(name: str) -> list[Tensor]:
    """Return the tensors of the result of a case, computed without changes."""
    with torch.no_grad():
        return tensors_of(CASES[name].call(*CASES[name].inputs))


CASES = cases()
