"""The graphs of a recipe: module, and name, type and unit of everything that goes in and out."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from fingerflow.export.recipe import GraphName, Recipe
from fingerflow.graphs.fields import SkinFieldsGraph
from fingerflow.stream.background import Background, BackgroundStep
from fingerflow.stream.contact import ContactStep
from fingerflow.stream.detect import DetectStep
from fingerflow.stream.frame import FrameResult, FrameStep, SinceOnsetResult, SinceOnsetStep
from fingerflow.stream.key import KeyStep, Templates
from fingerflow.stream.measured_contact import MeasuredContact, MeasuredContactStep
from fingerflow.stream.track import StreamTracks, TrackStep

_TYPES = {"uint8": torch.uint8, "float16": torch.float16, "float32": torch.float32, "float64": torch.float64}

#: Unit of every input and output; px are those of the views, counts those of the camera.
UNITS = {
    **dict.fromkeys(("contact_view", "topography_view", "background", "dark", "limit", "template_values"), "counts"),
    **dict.fromkeys(("template_level",), "counts"),
    **dict.fromkeys(("points", "prediction", "reference", "next_reference"), "px"),
    **dict.fromkeys(("template_start", "error", "deviation", "center", "semi_axes"), "px"),
    **dict.fromkeys(("real_area_px", "gross_area_px", "covariance"), "px^2"),
    **dict.fromkeys(("divergence", "curl", "strain", "median_divergence", "threshold"), "1"),
    **dict.fromkeys(("mask", "touching", "valid", "status", "topography_to_contact"), "1"),
    **dict.fromkeys(("covered", "reached", "next_reached"), "1"),
    "angle": "rad",
    "gain": "levels/count",
    "offset": "levels",
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
        precision: in place of the recipe's; a median carried by float32 or float64 follows it.
    """
    kind = precision or _TYPES[recipe.export.precision]
    contact, tracking = recipe.contact, recipe.tracking
    pixel = torch.uint8 if recipe.views.bit_depth == 8 else torch.uint16
    median_type = _TYPES[contact.median_type]
    scatter = contact.count_by == "scatter"
    known = ContactStep(contact.median_px, median_type, kind, contact.cell_px)
    measured = MeasuredContactStep(contact.median_px, median_type, contact.lattice_px, scatter, kind, contact.cell_px)
    table = (tracking.window_px, tracking.reach_px)
    track = TrackStep(*table, tracking.way_back, tracking.forward_backward_limit_px, kind)
    fields = SinceOnsetStep(SkinFieldsGraph(recipe.fields.gauge_px, kind))
    border = tracking.window_px // 2 + tracking.reach_px + 3  # window and table of the key frame
    detect = DetectStep(tracking.points, tracking.min_distance_px, border, kind)
    templates = Templates._fields
    shown = tuple(name for name in FrameResult._fields if name != "touching" or contact.touching)
    described = {
        "background": (BackgroundStep(pixel, kind), ("background", "dark", "threshold"), Background._fields),
        "contact": (measured, ("contact_view", "gain", "offset", "valid"), MeasuredContact._fields),
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
                *("limit", "valid", *templates),
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
