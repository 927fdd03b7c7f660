"""Graphs of an engine: torch modules for each of its computations, with the names of all inputs and outputs."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from fingerflow.graphs.contact_graph import ContactGraph
from fingerflow.graphs.detect import DetectGraph
from fingerflow.graphs.fields_graph import FieldsGraph
from fingerflow.graphs.track import KeyGraph, TrackGraph
from fingerflow.kernels.result_records import (
    CorrectedPoints,
    EnteredPoints,
    FrameContact,
    FrameEllipse,
    FrameFields,
    TrackedPoints,
)
from fingerflow.kernels.tracking_limits import WARP_GAUGE_PX
from fingerflow.ops.fields.point_gradients import query_gradients
from fingerflow.ops.filters.noise import estimate_noise
from fingerflow.ops.filters.spline import spline_coefficients
from fingerflow.ops.tracking.deformation import correct_points, fit_supports
from fingerflow.ops.tracking.outliers import find_outliers
from fingerflow.ops.tracking.search import search_and_return
from fingerflow.ops.tracking.templates import Templates, renew_templates
from fingerflow.ops.tracking.window_correlation import sample_windows
from fingerflow.schema.scene_tables import STEP, EngineSettings

TEMPLATES = tuple(f"template_{name}" for name in Templates._fields)
LIGHT = ("light", "black")
SUPPORTS = ("support_weights", "support_within", "inner_weights", "inner_within")


class Graph(nn.Module):
    """Torch module that passes tensors by position to a function or module, which returns a tuple of tensors; `inputs`
    and `outputs` are the names of these.
    """

    def __init__(
        self, function: Callable[..., tuple[Tensor, ...]], inputs: tuple[str, ...], outputs: tuple[str, ...]
    ) -> None:
        super().__init__()
        self.function, self.inputs, self.outputs = function, inputs, outputs

    def forward(self, *tensors: Tensor) -> tuple[Tensor, ...]:
        return self.function(*tensors)


def engine_graphs(settings: EngineSettings, points: int) -> dict[str, Graph]:
    """Return all graphs of an engine with these settings, by name.

    Args:
        settings: of the engine.
        points: number that `detect` finds.
    """
    detect = DetectGraph(points, settings.min_distance_px, settings.window_px)
    described = {
        **_contact_graphs(settings),
        "detect": (detect, ("topography_view", "mask"), ("points", "response")),
        **_point_graphs(settings),
        **_field_graphs(settings),
    }
    return {name: Graph(*parts).eval() for name, parts in described.items()}


_Described = dict[str, tuple[nn.Module | Callable[..., tuple[Tensor, ...]], tuple[str, ...], tuple[str, ...]]]


def _contact_graphs(settings: EngineSettings) -> _Described:
    """Return, by graph name, the function and the input and output names of each graph of the contact view."""
    graph = ContactGraph(settings.median_px, settings.gross_radius_px, settings.cell_px, settings.stride_px)
    shown = tuple(
        name
        for name in FrameContact._fields
        if (name != "real_contact_mask" or settings.real_contact_mask) and name != "threshold"
    )

    def contact(view: Tensor, light: Tensor, black: Tensor, threshold: Tensor) -> tuple[Tensor, ...]:
        frame_contact = graph(view, light, black, 1 - threshold)
        return tuple(getattr(frame_contact, name) for name in shown)

    return {
        "contact": (contact, ("contact_view", *LIGHT, "threshold"), shown),
        "threshold": (lambda *inputs: (graph.threshold(*inputs),), ("contact_view", *LIGHT), ("threshold",)),
    }


def _point_graphs(settings: EngineSettings) -> _Described:
    """Return, by graph name, the function and the input and output names of each graph of tracked points."""
    key, track = KeyGraph(settings.window_px, settings.gain_offset), TrackGraph(settings.forward_backward_limit_px)

    def prepare(view: Tensor, points: Tensor, noise: Tensor) -> tuple[Tensor, ...]:
        return tuple(key(view, points, noise))

    def renew(spline: Tensor, noise: Tensor, points: Tensor, warp: Tensor) -> tuple[Tensor, ...]:
        return tuple(renew_templates(spline, noise, points, settings.window_px, warp, gain_offset=settings.gain_offset))

    def find(*inputs: Tensor) -> tuple[Tensor, ...]:
        return tuple(track(Templates(*inputs[:3]), *inputs[3:]))

    def supports(start: Tensor) -> tuple[Any, ...]:
        return tuple(part for support in fit_supports(start, WARP_GAUGE_PX) for part in support or (None, None))

    def correct(start: Tensor, points: Tensor, covariance: Tensor, *rest: Tensor) -> tuple[Tensor, ...]:
        numbers, inverse_warp, outer, outer_within, inner, inner_within = rest
        # Compiled kernels need no precomputed supports.
        supports = None if outer is None else ((outer, outer_within), (inner, inner_within))
        inputs = start, points, covariance, numbers, inverse_warp, settings.window_px, WARP_GAUGE_PX
        return tuple(correct_points(*inputs, supports))

    def outliers(number: Tensor, offset: Tensor, within: Tensor, *inputs: Tensor) -> tuple[Tensor, ...]:
        start, points, deviation = inputs
        return tuple(find_outliers((number, offset, within), points - start, deviation))

    def search(key_view: Tensor, view: Tensor, points: Tensor, prediction: Tensor) -> tuple[Tensor, ...]:
        image, positions, guess = _flat(points, points, prediction)
        reach = (settings.window_px, settings.search_px, settings.forward_backward_limit_px)
        results = search_and_return(key_view, view, image, positions, guess, *reach)
        return tuple(one.unflatten(0, points.shape[:2]) for one in results)

    def windows(view: Tensor, points: Tensor, warp: Tensor) -> tuple[Tensor, ...]:
        image, positions, deformed = _flat(points, points, warp)
        flat = sample_windows(view, image, positions, deformed, settings.window_px, STEP)
        return (flat.unflatten(0, points.shape[:2]),)

    followed = (find, (*TEMPLATES, "topography_view", "prediction"), TrackedPoints._fields)
    return {
        "noise": (lambda view: (estimate_noise(view.to(torch.float32)),), ("topography_view",), ("noise",)),
        "spline": (lambda view: (spline_coefficients(view).to(torch.float32),), ("topography_view",), ("spline",)),
        "prepare": (prepare, ("topography_view", "points", "noise"), TEMPLATES),
        "renew": (renew, ("spline", "noise", "points", "warp"), TEMPLATES),
        "track": followed,
        "track_few": followed,
        "support": (supports, ("start",), SUPPORTS),
        "correct": (
            correct,
            ("start", "found", "found_covariance", "template_numbers", "inverse_warp", *SUPPORTS),
            CorrectedPoints._fields,
        ),
        "outliers": (
            outliers,
            (*("neighbour_number", "neighbour_offset", "neighbour_within"), *("start", "found", "position_std")),
            ("off_neighbours", "uncertain"),
        ),
        "search": (search, ("key_view", "topography_view", "points", "prediction"), ("places", "returns")),
        "windows": (windows, ("topography_view", "points", "warp"), ("samples",)),
    }


def _field_graphs(settings: EngineSettings) -> _Described:
    """Return, by graph name, the function and the input and output names of each graph of deformation fields."""
    graph = FieldsGraph(settings.gauge_length_mm, settings.strain)
    inputs = ("reference", "displacement", *(f"ellipse_{name}" for name in FrameEllipse._fields), "covariance")

    def fields(*arguments: Tensor) -> tuple[Tensor, ...]:
        reference, displacement, *ellipse, covariance = arguments[: len(inputs)]
        entered = arguments[len(inputs) :]
        among = EnteredPoints(*entered) if entered else None
        return tuple(graph(reference, displacement, covariance, FrameEllipse(*ellipse), among))

    return {
        "fields": (fields, inputs, FrameFields._fields),
        "fields_entered": (fields, (*inputs, "among", "gradient", "gradient_covariance"), FrameFields._fields),
        "fit": (
            query_gradients,
            ("reference", "displacement", "queries", "gauge_length", "variance"),
            ("gradient", "covariance"),
        ),
    }


def _flat(points: Tensor, *of_points: Tensor) -> tuple[Tensor, ...]:
    """Return the image (B N,) of each of the points (B, N, 2), and tensors (B, N, ...) as (B N, ...)."""
    batch, count = points.shape[:2]
    number = torch.arange(batch, device=points.device)[:, None].expand(batch, count).flatten()
    return number, *(tensor.flatten(0, 1) for tensor in of_points)
