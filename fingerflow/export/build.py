"""Torch modules for the graphs of an engine, with the names and units of all inputs and outputs."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass

import torch
from torch import Tensor, nn

from fingerflow.engines.bundle import bundle_settings
from fingerflow.engines.engine import STEP, EngineSettings
from fingerflow.export.portable import Portable
from fingerflow.graphs import ContactGraph, DetectGraph, Fields, FieldsGraph, KeyGraph, TrackGraph
from fingerflow.kernels.result_records import EnteredPoints, FrameContact, FrameEllipse, TrackedPoints
from fingerflow.kernels.tracking_limits import WARP_GAUGE_PX
from fingerflow.ops.fields.plane_fit import Support
from fingerflow.ops.fields.point_gradients import query_gradients
from fingerflow.ops.filters.noise import estimate_noise
from fingerflow.ops.filters.spline import spline_coefficients
from fingerflow.ops.tracking.deformation import correct_points, fit_supports
from fingerflow.ops.tracking.outliers import find_outliers
from fingerflow.ops.tracking.search import search_and_return
from fingerflow.ops.tracking.templates import Templates, renew_templates
from fingerflow.ops.tracking.window_correlation import sample_windows
from fingerflow.schema.recipe import GRAPHS, GraphName, Recipe

_TEMPLATES = tuple(f"template_{name}" for name in Templates._fields)
_LIGHT = ("light", "black")
_ELLIPSE = FrameEllipse._fields
_FIELDS = Fields._fields
_SUPPORTS = ("support_weights", "support_within", "inner_weights", "inner_within")
_CORRECTED = ("points", "covariance", "warp", "shift", "expected")

#: Unit of every input and output: px of the views, grey levels of the camera ("counts"), mm on the glass.
UNITS = {
    **dict.fromkeys(("contact_view", "topography_view", "key_view", "empty", "dark"), "counts"),
    **dict.fromkeys((*_LIGHT, "noise", "spline", "samples"), "counts"),
    **dict.fromkeys(("points", "prediction", "estimate", "start", "found", "expected", "places", "shift"), "px"),
    **dict.fromkeys(("error", "position_std", "center", "semi_axes", "template_start", "neighbour_offset"), "px"),
    **dict.fromkeys(("real_area_px", "gross_area_px", "found_covariance"), "px^2"),
    **dict.fromkeys(("covariance", "variance"), "square of the unit of what varies"),
    **dict.fromkeys(
        (*_FIELDS, "gradient", "gradient_covariance", "threshold", "illumination_gain", "density_margin"), "1"
    ),
    **dict.fromkeys(("mask", "real_contact_mask", "status", "warp", "inverse_warp", "returns", "among"), "1"),
    **dict.fromkeys(("neighbour_number", "neighbour_within", *_SUPPORTS), "1"),
    **dict.fromkeys(("off_neighbours", "uncertain"), "1"),
    **dict.fromkeys(("reference", "displacement", "queries", "gauge_length"), "mm"),
    **dict.fromkeys(("ellipse_center", "ellipse_semi_axes"), "mm"),
    **dict.fromkeys(("angle", "ellipse_angle"), "rad"),
    "response": "counts^2/px^2",
    "template_samples": "counts, counts/px",
    "template_numbers": "see kernels.tracking_limits.Number",
}


@dataclass(frozen=True)
class Graph:
    """Graph for export: a torch module that maps tensors to a tuple of tensors, with names of inputs and outputs."""

    module: nn.Module
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def run(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Run the graph in torch, with implementations that ONNX can express; return its outputs by name, from its
        inputs by name in `values`.
        """
        with torch.inference_mode(), Portable():
            results = self.module(*(values[name] for name in self.inputs))
        return dict(zip(self.outputs, results, strict=True))


class _Call(nn.Module):
    """Torch module that wraps a function or module and passes tensors to it by position."""

    def __init__(self, function: Callable[..., tuple[Tensor, ...]]) -> None:
        super().__init__()
        self.function = function

    def forward(self, *tensors: Tensor) -> tuple[Tensor, ...]:
        return self.function(*tensors)


def build_graphs(recipe: Recipe) -> dict[GraphName, Graph]:
    """Build all graphs of a recipe, by name in order of execution, including graphs that are not exported."""
    settings = bundle_settings(asdict(recipe))
    return build(settings, recipe.tracking.points, recipe.contact.real_contact_mask)


def build(settings: EngineSettings, points: int, real_contact_mask: bool = True) -> dict[GraphName, Graph]:
    """Build all graphs of an engine with these settings, by name in order of execution.

    Args:
        points: number that `detect` finds.
        real_contact_mask: whether `contact` returns the mask.
    """
    described = {
        **_contact_graphs(settings, real_contact_mask),
        **_point_graphs(settings),
        **_field_graphs(settings),
    }
    described["detect"] = (
        DetectGraph(points, settings.min_distance_px, settings.window_px),
        ("topography_view", "mask"),
        ("points", "response"),
    )
    graphs = {}
    for name in GRAPHS:
        call, inputs, outputs = described[name]
        graphs[name] = Graph(_Call(call).eval(), inputs, outputs)
    return graphs


_Described = dict[str, tuple[nn.Module | Callable[..., tuple[Tensor, ...]], tuple[str, ...], tuple[str, ...]]]


def _contact_graphs(settings: EngineSettings, real_contact_mask: bool) -> _Described:
    """Return, by graph name, the function and the input and output names of each graph of the contact view."""
    graph = ContactGraph(settings.median_px, settings.gross_radius_px, settings.cell_px, settings.stride_px)
    shown = tuple(
        name
        for name in FrameContact._fields
        if (name != "real_contact_mask" or real_contact_mask) and name != "threshold"
    )

    def contact(view: Tensor, light: Tensor, black: Tensor, threshold: Tensor) -> tuple[Tensor, ...]:
        frame_contact = graph(view, light, black, 1 - threshold)
        return tuple(getattr(frame_contact, name) for name in shown)

    return {
        "contact": (contact, ("contact_view", *_LIGHT, "threshold"), shown),
        "threshold": (lambda *inputs: (graph.threshold(*inputs),), ("contact_view", *_LIGHT), ("threshold",)),
    }


def _point_graphs(settings: EngineSettings) -> _Described:
    """Return, by graph name, the function and the input and output names of each graph of tracked points."""
    key, track = KeyGraph(settings.window_px, settings.gain_offset), TrackGraph(settings.forward_backward_limit_px)

    def prepare(view: Tensor, points: Tensor, noise: Tensor) -> tuple[Tensor, ...]:
        return _known_tensors(key(view, points, noise))

    def renew(spline: Tensor, noise: Tensor, points: Tensor, warp: Tensor) -> tuple[Tensor, ...]:
        window, gain_offset = settings.window_px, settings.gain_offset
        return _known_tensors(renew_templates(spline, noise, points, window, warp, gain_offset=gain_offset))

    def find(*inputs: Tensor) -> tuple[Tensor, ...]:
        return tuple(track(Templates(*inputs[:3]), *inputs[3:]))

    def support(start: Tensor) -> tuple[Tensor, ...]:
        # Compiled kernels need no precomputed supports.
        return tuple(part for one in fit_supports(start, WARP_GAUGE_PX) if one is not None for part in one)

    def correct(start: Tensor, points: Tensor, covariance: Tensor, *rest: Tensor) -> tuple[Tensor, ...]:
        numbers, inverse_warp, *of = rest
        inputs = start, points, covariance, numbers, inverse_warp
        supports = Support(*of[:2]), Support(*of[2:])
        return tuple(correct_points(*inputs, settings.window_px, WARP_GAUGE_PX, supports))

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

    followed = (find, (*_TEMPLATES, "topography_view", "prediction"), TrackedPoints._fields)
    return {
        "noise": (lambda view: (estimate_noise(view.to(torch.float32)),), ("topography_view",), ("noise",)),
        "spline": (lambda view: (spline_coefficients(view).to(torch.float32),), ("topography_view",), ("spline",)),
        "prepare": (prepare, ("topography_view", "points", "noise"), _TEMPLATES),
        "renew": (renew, ("spline", "noise", "points", "warp"), _TEMPLATES),
        "track": followed,
        "track_few": followed,
        "support": (support, ("start",), _SUPPORTS),
        "correct": (
            correct,
            ("start", "found", "found_covariance", "template_numbers", "inverse_warp", *_SUPPORTS),
            _CORRECTED,
        ),
        "outliers": (
            outliers,
            (
                *("neighbour_number", "neighbour_offset", "neighbour_within"),
                *("start", "found", "position_std"),
            ),
            ("off_neighbours", "uncertain"),
        ),
        "search": (search, ("key_view", "topography_view", "points", "prediction"), ("places", "returns")),
        "windows": (windows, ("topography_view", "points", "warp"), ("samples",)),
    }


def _field_graphs(settings: EngineSettings) -> _Described:
    """Return, by graph name, the function and the input and output names of each graph of deformation fields."""
    graph = FieldsGraph(settings.gauge_length_mm, settings.strain)
    inputs = ("reference", "displacement", *(f"ellipse_{name}" for name in _ELLIPSE), "covariance")

    def fields(*arguments: Tensor) -> tuple[Tensor, ...]:
        reference, displacement, *ellipse, covariance = arguments[: len(inputs)]
        entered = arguments[len(inputs) :]
        among = EnteredPoints(*entered) if entered else None
        frame_fields = graph(reference, displacement, covariance, FrameEllipse(*ellipse), among)
        return tuple(getattr(frame_fields, name) for name in _FIELDS)

    return {
        "fields": (fields, inputs, _FIELDS),
        "fields_entered": (fields, (*inputs, "among", "gradient", "gradient_covariance"), _FIELDS),
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


def _known_tensors(templates: Templates) -> tuple[Tensor, ...]:
    """Return the tensors of `Templates` (image windows around the tracked points) as a tuple, without fields that are
    None.
    """
    return tuple(tensor for tensor in templates if tensor is not None)
