"""The graphs of a recipe: module, and name, type and unit of everything that goes in and out."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from fingerflow.export.recipe import GraphName, Recipe
from fingerflow.graphs.contact import Contact, ContactGraph
from fingerflow.graphs.fields import SkinFieldsGraph
from fingerflow.graphs.light import Light, LightGraph
from fingerflow.stream.detect import DetectStep
from fingerflow.stream.frame import FrameResult, FrameStep, SinceOnsetResult, SinceOnsetStep
from fingerflow.stream.key import KeyStep, Templates
from fingerflow.stream.track import StreamTracks, TrackStep

_TYPES = {"uint8": torch.uint8, "float16": torch.float16, "float32": torch.float32, "float64": torch.float64}

#: Unit of every input and output; px are those of the views, counts those of the camera.
UNITS = {
    **dict.fromkeys(
        ("contact_view", "topography_view", "background", "dark", "light", "black", "template_values"), "counts"
    ),
    **dict.fromkeys(("template_level",), "counts"),
    **dict.fromkeys(("points", "prediction", "reference", "next_reference"), "px"),
    **dict.fromkeys(("template_start", "error", "deviation", "center", "semi_axes"), "px"),
    **dict.fromkeys(("real_area_px", "gross_area_px", "covariance"), "px^2"),
    **dict.fromkeys(("divergence", "curl", "strain", "median_divergence", "threshold", "limit", "light_gain"), "1"),
    **dict.fromkeys(("mask", "touching", "status", "topography_to_contact"), "1"),
    **dict.fromkeys(("covered", "reached", "next_reached"), "1"),
    "angle": "rad",
    "response": "counts^2/px^2",
    "template_noise": "counts^2",
    "template_products": "px^2/counts^2, counts^2, counts^2/px^3, 1",
    "template_gradients": "counts/px",
    "template_pixels": "counts/px",
    "template_table": "counts^2/px",
}


@dataclass(frozen=True)
class Graph:
    """A module with positional tensors, and their names; `outputs` are those of the module's tuple that are kept."""

    module: nn.Module
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


_MEASURED = tuple(name for name in Contact._fields if name != "excess")


class _Measured(nn.Module):
    """Contact with the threshold measured in the frame itself, and that threshold."""

    def __init__(self, graph: ContactGraph) -> None:
        super().__init__()
        self.graph = graph

    def forward(self, contact_view: Tensor, light: Tensor, black: Tensor) -> tuple[Tensor, ...]:
        threshold = self.graph.threshold(contact_view, light, black)
        contact = self.graph(contact_view, light, black, 1 - threshold)._asdict()
        return (*(contact[name] for name in _MEASURED), threshold)


class _Flat(nn.Module):
    """A module whose last argument is `Templates`, with one argument a tensor, and some of its outputs."""

    def __init__(self, module: nn.Module, names: tuple[str, ...], kept: tuple[str, ...], templates: bool) -> None:
        super().__init__()
        self.module = module
        self.kept = [names.index(name) for name in kept]
        self.plain = -len(Templates._fields) if templates else None

    def forward(self, *tensors: Tensor) -> tuple[Tensor, ...]:
        arguments = tensors if self.plain is None else (*tensors[: self.plain], Templates(*tensors[self.plain :]))
        results = self.module(*arguments)
        return tuple(results[place] for place in self.kept)


def build(recipe: Recipe, precision: torch.dtype | None = None) -> dict[GraphName, Graph]:
    """The graphs that a recipe asks for, in the order in which they can run.

    Args:
        precision: in place of the recipe's.
    """
    kind = precision or _TYPES[recipe.export.precision]
    contact, tracking = recipe.contact, recipe.tracking
    known = ContactGraph(contact.median_px, contact.gross_radius_px, contact.cell_px, contact.lattice_px)
    table = (tracking.window_px, tracking.reach_px)
    track = TrackStep(*table, tracking.way_back, tracking.forward_backward_limit_px, kind)
    fields = SinceOnsetStep(SkinFieldsGraph(recipe.fields.gauge_px, kind))
    border = tracking.window_px // 2 + tracking.reach_px + 3  # window and table of the key frame
    detect = DetectStep(tracking.points, tracking.min_distance_px, border, kind)
    templates = Templates._fields
    shown = tuple(name for name in FrameResult._fields if name != "touching" or contact.touching)
    described = {
        "background": (LightGraph(kind), ("background", "dark", "threshold"), Light._fields),
        "contact": (_Measured(known), ("contact_view", "light", "black"), (*_MEASURED, "threshold")),
        "detect": (detect, ("topography_view", "mask"), ("points", "response")),
        "key": (KeyStep(*table, kind), ("topography_view", "points"), templates),
        "track": (track, ("topography_view", "prediction", *templates), StreamTracks._fields),
        "fields": (
            fields,
            (
                *("points", "covered", "reference", "reached", "topography_to_contact"),
                *("center", "semi_axes", "angle"),
            ),
            SinceOnsetResult._fields,
        ),
        "frame": (
            FrameStep(known, track),
            (
                *("contact_view", "topography_view", "topography_to_contact", "prediction"),
                *(*Light._fields, *templates),
            ),
            FrameResult._fields,
        ),
    }
    return {
        name: Graph(
            _Flat(module, outputs, shown if name == "frame" else outputs, name in ("track", "frame")).eval(),
            inputs,
            shown if name == "frame" else outputs,
        )
        for name, (module, inputs, outputs) in described.items()
        if name in recipe.export.graphs
    }
