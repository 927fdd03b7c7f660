"""Torch modules for the graphs of a recipe, with the names and units of all inputs and outputs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from fingerflow.engines.engine import STEP
from fingerflow.export.portable import Portable
from fingerflow.export.recipe import GRAPHS, GraphName, Recipe
from fingerflow.graphs import (
    AgreementGraph,
    Contact,
    ContactGraph,
    DeformationGraph,
    Entered,
    FieldsGraph,
    GrossEllipse,
    KeyGraph,
    TrackGraph,
)
from fingerflow.graphs.detect import DetectGraph
from fingerflow.graphs.search_graph import SearchGraph
from fingerflow.kernels.tracking_limits import WARP_GAUGE_PX
from fingerflow.ops.fields.plane_fit import Support
from fingerflow.ops.fields.point_gradients import gradients_at
from fingerflow.ops.filters.illumination import glass_light
from fingerflow.ops.filters.noise import estimate_noise
from fingerflow.ops.filters.spline import spline_coefficients
from fingerflow.ops.tracking.deformation import Supports, supports_of
from fingerflow.ops.tracking.outliers import Neighbours
from fingerflow.ops.tracking.templates import Found, Templates, renew_templates
from fingerflow.ops.tracking.window_correlation import sample_windows

TYPES = {"float32": torch.float32, "float64": torch.float64}

_TEMPLATES = tuple(f"template_{name}" for name in Templates._fields)
#: Graphs that process a fixed number `engines.engine.ROWS` of points (rows), and their inputs that are cut to this
#: number.
OF_FEW: dict[str, tuple[str, ...]] = {
    "renew": ("points", "warp"),
    "track_few": (*_TEMPLATES, "prediction"),
    "search": ("points", "prediction"),
    "windows": ("points", "warp"),
}

_LIGHT = ("light", "black")
_ELLIPSE = GrossEllipse._fields
_FIELDS = ("divergence", "curl", "strain", "shear", "median", "known_share")
_SUPPORTS = ("support_weights", "support_within", "inner_weights", "inner_within")
_CORRECTED = ("points", "covariance", "warp", "shift", "expected")

#: Unit of every input and output: px of the views, grey levels of the camera ("counts"), mm on the glass.
UNITS = {
    **dict.fromkeys(("contact_view", "topography_view", "key_view", "empty", "dark"), "counts"),
    **dict.fromkeys((*_LIGHT, "noise", "spline", "samples"), "counts"),
    **dict.fromkeys(("points", "prediction", "estimate", "start", "found", "expected", "places", "shift"), "px"),
    **dict.fromkeys(("error", "position_std", "center", "semi_axes", "template_start", "neighbour_offset"), "px"),
    **dict.fromkeys(("real_area_px", "gross_area_px", "covariance", "found_covariance"), "px^2"),
    **dict.fromkeys((*_FIELDS, "gradient", "threshold", "illumination_gain", "density_margin"), "1"),
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

    def run(self, known: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Run the graph in torch, with implementations that ONNX can express; return its outputs by name, from its
        inputs by name in `known`.
        """
        with torch.inference_mode(), Portable():
            results = self.module(*(known[name] for name in self.inputs))
        return dict(zip(self.outputs, results, strict=True))


class _Call(nn.Module):
    """Torch module that wraps a function or module and passes tensors to it by position."""

    def __init__(self, function: Callable[..., tuple[Tensor, ...]]) -> None:
        super().__init__()
        self.function = function

    def forward(self, *tensors: Tensor) -> tuple[Tensor, ...]:
        return self.function(*tensors)


def build(recipe: Recipe, precision: torch.dtype | None = None) -> dict[GraphName, Graph]:
    """Build all graphs of a recipe, by name in order of execution, including graphs that are not exported.

    Args:
        precision: replaces the recipe's.
    """
    kind = precision or TYPES[recipe.export.precision]
    own = recipe.tracking
    described = {**_contact_graphs(recipe, kind), **_point_graphs(recipe, kind), **_field_graphs(recipe)}
    described["detect"] = (
        DetectGraph(own.points, own.min_distance_px, own.window_px, kind),
        ("topography_view", "mask"),
        ("points", "response"),
    )
    graphs = {}
    for name in GRAPHS:
        call, inputs, outputs = described[name]
        graphs[name] = Graph(_Call(call).eval(), inputs, outputs)
    return graphs


_Described = dict[str, tuple[nn.Module | Callable[..., tuple[Tensor, ...]], tuple[str, ...], tuple[str, ...]]]


def _contact_graphs(recipe: Recipe, kind: torch.dtype) -> _Described:
    """Return, by graph name, the function and the input and output names of each graph of the contact view; `kind` is
    the precision of the light of the empty glass.
    """
    own = recipe.contact
    graph = ContactGraph(own.median_px, own.gross_radius_px, own.cell_px, own.stride_px)
    shown = tuple(name for name in Contact._fields if name != "real_contact_mask" or own.real_contact_mask)

    def contact(view: Tensor, light: Tensor, black: Tensor, threshold: Tensor) -> tuple[Tensor, ...]:
        found = graph(view, light, black, 1 - threshold)
        return tuple(getattr(found, name) for name in shown)

    return {
        "light": (lambda empty, dark: glass_light(empty, dark, kind), ("empty", "dark"), _LIGHT),
        "contact": (contact, ("contact_view", *_LIGHT, "threshold"), shown),
        "threshold": (lambda *given: (graph.threshold(*given),), ("contact_view", *_LIGHT), ("threshold",)),
    }


def _point_graphs(recipe: Recipe, kind: torch.dtype) -> _Described:
    """Return, by graph name, the function and the input and output names of each graph of tracked points; `kind` is the
    precision of the image noise and of the spline coefficients.
    """
    own = recipe.tracking
    key, track, deformation = (
        KeyGraph(own.window_px, own.gain_offset),
        TrackGraph(own.forward_backward_limit_px),
        DeformationGraph(own.window_px),
    )
    agreement = AgreementGraph()
    search = SearchGraph(own.window_px, own.search_px, own.forward_backward_limit_px)

    def prepare(view: Tensor, points: Tensor, noise: Tensor) -> tuple[Tensor, ...]:
        return _known_tensors(key(view, points, noise))

    def renew(spline: Tensor, noise: Tensor, points: Tensor, warp: Tensor) -> tuple[Tensor, ...]:
        return _known_tensors(renew_templates(spline, noise, points, own.window_px, warp, gain_offset=own.gain_offset))

    def find(*given: Tensor) -> tuple[Tensor, ...]:
        return tuple(track(Templates(*given[:3]), *given[3:]))

    def support(start: Tensor) -> tuple[Tensor, ...]:
        # Compiled kernels need no precomputed supports.
        return tuple(part for one in supports_of(start, WARP_GAUGE_PX) if one is not None for part in one)

    def correct(start: Tensor, points: Tensor, covariance: Tensor, *known: Tensor) -> tuple[Tensor, ...]:
        # Fields error, status and estimate are unused.
        found = Found(points, points[..., 0], covariance, points[..., 0], points)
        numbers, inverse_warp, *of = known
        supports = Supports(Support(*of[:2]), Support(*of[2:]))
        corrected, *others = deformation(start, found, numbers, inverse_warp, supports)
        return corrected.points, corrected.covariance, *others

    def outliers(number: Tensor, offset: Tensor, within: Tensor, *given: Tensor) -> tuple[Tensor, ...]:
        return tuple(agreement(Neighbours(number, offset, within), *given))

    def windows(view: Tensor, points: Tensor, warp: Tensor) -> tuple[Tensor, ...]:
        batch, count = points.shape[:2]
        number = torch.arange(batch, device=points.device)[:, None].expand(batch, count).flatten()
        flat = sample_windows(view, number, points.flatten(0, 1), warp.flatten(0, 1), own.window_px, STEP)
        return (flat.unflatten(0, (batch, count)),)

    followed = (find, (*_TEMPLATES, "topography_view", "prediction"), Found._fields)
    return {
        "noise": (lambda view: (estimate_noise(view.to(kind)),), ("topography_view",), ("noise",)),
        "spline": (lambda view: (spline_coefficients(view).to(kind),), ("topography_view",), ("spline",)),
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


def _field_graphs(recipe: Recipe) -> _Described:
    """Return, by graph name, the function and the input and output names of each graph of deformation fields."""
    graph = FieldsGraph(recipe.fields.gauge_length_mm)
    inputs = ("reference", "displacement", *(f"ellipse_{name}" for name in _ELLIPSE))

    def fields(reference: Tensor, displacement: Tensor, *others: Tensor) -> tuple[Tensor, ...]:
        ellipse, own = GrossEllipse(*others[:3]), others[3:]
        found = graph(reference, displacement, None, ellipse, Entered(own[0], own[1], None) if own else None)
        return tuple(getattr(found, name) for name in _FIELDS)

    return {
        "fields": (fields, inputs, _FIELDS),
        "fields_entered": (fields, (*inputs, "among", "gradient"), _FIELDS),
        "fit": (
            lambda *given: (gradients_at(*given),),
            ("reference", "displacement", "queries", "gauge_length"),
            ("gradient",),
        ),
    }


def _known_tensors(templates: Templates) -> tuple[Tensor, ...]:
    """Return the tensors of `Templates` (image windows around the tracked points) as a tuple, without fields that are
    None.
    """
    return tuple(one for one in templates if one is not None)
