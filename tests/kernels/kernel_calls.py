"""One call of every function of kernels, with work for several threads.

Tests of faults, of NumPy arrays and of the compiler use these calls. A new function gets a row in `kernel_calls`.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from fingerflow.engines.contact_view import covers
from fingerflow.engines.engine import EngineSettings
from fingerflow.engines.native import NativeEngine
from fingerflow.kernels import tensors as kernels
from fingerflow.kernels import tracking
from fingerflow.kernels.contact import contact_threshold
from fingerflow.kernels.fields import fields_of_frames
from fingerflow.kernels.kernel import Kernel
from fingerflow.kernels.library import compiled
from fingerflow.kernels.result_records import EnteredPoints, FrameEllipse
from fingerflow.kernels.tensors import twin
from fingerflow.kernels.tracking_limits import NUMBERS
from fingerflow.tracker.displacement_medians import displacement_medians
from tests.embedded import CASES, scene


class Call(NamedTuple):
    """A function and its arguments; calling it returns the result, with tensors in place of arrays."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    settings: dict[str, Any]

    def __call__(self) -> Any:
        return in_tensors(self.function(*self.arguments, **self.settings))


def call(function: Callable[..., Any], *arguments: Any, **settings: Any) -> Call:
    return Call(function, arguments, settings)


def in_tensors(result: Any) -> Any:
    """Return the result with a tensor for every array."""
    if isinstance(result, np.ndarray):
        return torch.from_numpy(result)
    return tuple(map(in_tensors, result)) if isinstance(result, tuple) else result


def kernel_calls() -> dict[str, Call]:
    """Return the calls by the name of the kernel, or of the op that reaches it."""
    first, second, points, moved = scene()
    tall = first.repeat(1, 1, 4, 1)
    covered = tall > 110
    light, one = torch.full((1, 1, *tall.shape[2:]), 200.0), torch.ones(2)
    dimmed = (0.9 * light).byte().repeat(2, 1, 1, 1)
    covariance = torch.eye(2).expand(*points.shape, 2).contiguous() / 100
    triangles = torch.tensor([[0, 1, 2], [3, 4, 5], [6, 7, 8]])
    rows = points.shape[1]
    templates = list(twin("prepare_templates")(first, points, None, one, 11, 1, 0.0))
    fits = {"radius": 30.0, "minimum_points": 5}
    ellipses, area = torch.tensor([[40.0, 32.0, 20.0, 16.0, 1.0, 0.0]]).repeat(2, 1), torch.ones(3)
    wide = first.repeat(1, 1, 8, 8).float()  # for flow, whose cells are a fourth of the pixels

    return {
        "median": call(kernels.median, tall, 5),
        "normalize": call(twin("normalize"), tall, light, 0 * light, one[:1]),
        "real_contact_mask": call(twin("real_contact_mask"), tall, light, 0 * light, one / 2, 3),
        "illumination_gain": call(twin("illumination_gain"), dimmed, light, 0 * light, 8),
        "histogram": call(kernels.histogram, tall, covered, None, 256),
        "apparent_contact": call(twin("apparent_contact"), covered, 8, 4),
        "mean_response": call(twin("mean_response"), tall),
        "halve": call(twin("halve"), tall),
        "spline_coefficients": call(twin("spline_coefficients"), tall),
        "prepare_templates": call(twin("prepare_templates"), first, points, None, one, 11, 1, 0.0),
        "find_templates": call(kernels.find_templates, templates, second, points, None, None, 8, 0.0, 1.0, 0.5),
        "find_pairs": call(
            *(twin("find_pairs"), first, second, points, None, one, 11, 1, 8, points, None, 0.0, 1.0, 0.5)
        ),
        "search_windows": call(
            twin("search_windows"), light, light, torch.zeros(rows).long(), points[0], points[0], 31, 3
        ),
        "sample_windows": call(
            twin("sample_windows"), tall, torch.zeros(rows).long(), points[0], torch.eye(2).repeat(rows, 1, 1), 4, 1
        ),
        "local_gradients": call(kernels.local_gradients, points, moved, points, covariance.flatten(2), **fits),
        "local_gradients without noise": call(kernels.local_gradients, points, moved, points, None, **fits),
        "medians_over_area": call(
            kernels.area_medians, points[:1], moved, ellipses, covariance, None, None, None, measure=0, radius=30.0
        ),
        "strain_of_triangles": call(
            *(kernels.triangle_strain, triangles, torch.ones(3, 3, 2), torch.ones(3, 3, 3), area, area, moved),
            *(covariance, torch.ones(2, 3, dtype=torch.bool)),
            measure=0,
            stiffness=(1.0, 1.0, 1.0),
        ),
        # Called by itself, because the threads exist already where dense flow reaches this kernel.
        "flow_template": call(twin("flow_template"), wide, torch.ones_like(wide), 2),
        **calls_on_arrays(tall, light),
    }


def calls() -> dict[str, Callable[[], Any]]:
    """Return calls that reach every kernel, by itself and through the ops."""
    of_ops: dict[str, Callable[[], Any]] = {name: partial(case.call, *case.inputs) for name, case in CASES.items()}
    return kernel_calls() | of_ops


def calls_on_arrays(tall: Tensor, light: Tensor) -> dict[str, Call]:
    """Return calls of the functions that take NumPy arrays only."""
    random = np.random.default_rng(0)
    points = random.uniform(10, 190, (60, 2)).astype(np.float32)
    moved = points + random.normal(size=(2, 60, 2)).astype(np.float32)
    covariance = np.broadcast_to(np.eye(2, dtype=np.float32), (2, 60, 2, 2))
    numbers, deviation = np.ones((60, NUMBERS), np.float32), np.ones((2, 60), np.float32)
    frames, glass, black = (image.numpy() for image in (tall, light, 0 * light))
    frame, everywhere = frames[:1], np.ones((1, 1, *frames.shape[2:]), np.bool_)
    grey = random.normal(100, 20, (6, 200, 81)).astype(np.float32)
    engine = NativeEngine(EngineSettings(median_px=3, gross_radius_px=8, cell_px=4, window_px=9, search_px=3))
    lit = (frames, (glass, black))
    doubles = (values.astype(np.float64) for values in (moved, moved - points, deviation))
    ellipse = FrameEllipse(np.full((2, 2), 100.0), np.full((2, 2), 80.0), np.zeros(2))
    spread = np.broadcast_to(np.eye(4, dtype=np.float32).reshape(2, 2, 2, 2), (2, 60, 2, 2, 2, 2))
    entered_points = EnteredPoints(random.random((2, 60)) < 0.2, covariance, spread)
    windows = {"then": grey[0], "around": grey[2:], "now": grey[1]}
    return {
        "contact_of_frames": call(engine.contact, *lit, np.full(2, 0.5, np.float32)),
        "contact_threshold": call(
            *(contact_threshold, frames, glass, black, np.ones(2, np.float32)), median_px=3, radius=8, stride_px=1
        ),
        "covered": call(covers, glass, points[None], np.ones((2, 3), np.float32), 4),
        "strip_differences": call(compiled("strip_differences"), frames=frames, apart=1),
        "block_means": call(compiled("block_means"), frames=frames, down=2, along=2, rows=4, columns=4, every=2),
        "correct_points": call(
            tracking.correct_points, points, moved, covariance, numbers, covariance[0], window=25, gauge_px=120.0
        ),
        "find_outliers": call(
            tracking.find_outliers, tracking.find_neighbours(points, 120.0), moved - points, deviation
        ),
        "search_and_return": call(engine.search, engine.prepare(frame, points[:0]), frame, points, points),
        "frame_distances": call(compiled("frame_distances"), now=grey[:3], before=grey[3:], bands=8, most=30.0),
        "shift_windows": call(
            compiled("shift_windows"), **windows, shift=np.zeros((200, 2)), weight=np.ones((200, 81)), noise=1.0
        ),
        "detect_points": call(engine.detect, frame, everywhere[0, 0], 20),
        "displacement_medians": call(displacement_medians, *doubles, ellipse, 40.0),
        "fields_of_frames": call(
            fields_of_frames, points, moved - points, ellipse, covariance, entered_points, measure=0, radius=40.0
        ),
    }


@contextmanager
def entered(seen: Callable[[str, dict[str, Any], Callable[[], Any]], Any]) -> Iterator[None]:
    """Within this context call `seen` with the name and the arguments of every kernel that is entered, and a function
    that enters it; it returns the results.
    """
    plain = Kernel.__call__

    def called(self: Kernel, **given: Any) -> Any:
        return seen(self._name, given, lambda: plain(self, **given))

    Kernel.__call__ = called  # type: ignore[method-assign]
    try:
        yield
    finally:
        Kernel.__call__ = plain  # type: ignore[method-assign]


def reached(call: Callable[[], Any]) -> dict[str, dict[str, Any]]:
    """Return the arguments of the kernels that a call enters, by name."""
    arguments: dict[str, dict[str, Any]] = {}

    def noted(name: str, given: dict[str, Any], enter: Callable[[], Any]) -> Any:
        arguments[name] = given
        return enter()

    with entered(noted):
        call()
    return arguments
