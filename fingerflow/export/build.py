"""The graphs of a recipe: module, and name, type and unit of everything that goes in and out."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from fingerflow.export.recipe import GraphName, Recipe
from fingerflow.graphs import Contact, ContactGraph, KeyGraph, Light, LightGraph
from fingerflow.graphs.detect import DetectGraph
from fingerflow.graphs.frame import (
    Followed,
    FollowGraph,
    FrameGraph,
    FrameResult,
    Held,
    HeldGraph,
    KeyView,
    Prepared,
    RenewGraph,
    SinceOnset,
    SinceOnsetGraph,
)
from fingerflow.graphs.search import SearchGraph

_TYPES = {"float32": torch.float32, "float64": torch.float64}

RENEWED = 64  # points whose templates `renew` prepares in a call
SEARCHED = 64  # points that `search` looks for in a call: the motion of the others follows from theirs

#: Unit of every input and output; px are those of the views, counts those of the camera.
UNITS = {
    **dict.fromkeys(("contact_view", "topography_view", "key_view", "background", "dark"), "counts"),
    **dict.fromkeys(("light", "black"), "counts"),
    **dict.fromkeys(("points", "prediction", "reference", "next_reference", "by_neighbours"), "px"),
    **dict.fromkeys(("estimate", "found", "chosen"), "px"),
    **dict.fromkeys(("error", "position_std", "center", "semi_axes", "template_start"), "px"),
    **dict.fromkeys(("real_area_px", "gross_area_px"), "px^2"),
    **dict.fromkeys(("divergence", "curl", "strain", "median_divergence", "threshold", "limit", "light_gain"), "1"),
    **dict.fromkeys(
        ("mask", "real_contact_mask", "status", "topography_to_contact", "warp", "template_inverse_warp"), "1"
    ),
    **dict.fromkeys(("stale", "neighbours_weights", "neighbours_within"), "1"),
    **dict.fromkeys(("key_image", "key_noise"), "counts"),
    **dict.fromkeys(("covered", "reached", "next_reached", "entry", "next_entry", "moved_in"), "1"),
    **dict.fromkeys(("at_entry", "next_at_entry"), "1"),
    "mm_per_px": "mm/px",
    "angle": "rad",
    "response": "counts^2/px^2",
    "template_samples": "counts, counts/px",
    "template_table": "counts^2/px, counts^2",
    "template_numbers": "see ops.tracking_limits.Number",
    "steepest_descent_images": "counts, counts/px",
}


@dataclass(frozen=True)
class Graph:
    """A module with positional tensors, and their names; `outputs` are those of the module's tuple that are kept."""

    module: nn.Module
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


OF_FRAME = (*Prepared._fields, *(name for name in Held._fields if name != "prepared"))  # the tensors of `Held`


class _Flat(nn.Module):
    """A module whose last argument may be `Held`, with one argument a tensor that is given, and some of its outputs."""

    def __init__(
        self, module: nn.Module, names: tuple[str, ...], kept: tuple[str, ...], given: tuple[str, ...]
    ) -> None:
        super().__init__()
        self.module = module
        self.kept = [names.index(name) for name in kept]
        self.plain = [place for place, name in enumerate(given) if name not in OF_FRAME]
        self.held = [given.index(name) if name in given else None for name in OF_FRAME]

    def forward(self, *tensors: Tensor) -> tuple[Tensor, ...]:
        arguments: tuple[Any, ...] = tuple(tensors[place] for place in self.plain)
        if len(arguments) < len(tensors):
            held: list[Any] = [None if place is None else tensors[place] for place in self.held]
            own = len(Prepared._fields)
            arguments = (*arguments, Held(Prepared(*held[:own]), *held[own:]))
        results = list(_leaves(self.module(*arguments)))
        return tuple(results[place] for place in self.kept)


def _leaves(results: Any) -> Iterator[Any]:
    """Of nested tuples, in order."""
    if isinstance(results, tuple):
        for one in results:
            yield from _leaves(one)
    else:
        yield results


_MEASURED = tuple(name for name in Contact._fields if name != "density_margin")


class _Measured(nn.Module):
    """Contact with the threshold measured in the frame itself, and that threshold."""

    def __init__(self, graph: ContactGraph) -> None:
        super().__init__()
        self.graph = graph

    def forward(self, contact_view: Tensor, light: Tensor, black: Tensor) -> tuple[Tensor, ...]:
        threshold = self.graph.threshold(contact_view, light, black)
        contact = self.graph(contact_view, light, black, 1 - threshold)._asdict()
        return (*(contact[name] for name in _MEASURED), threshold)


def build(
    recipe: Recipe, precision: torch.dtype | None = None, without: Collection[str] = ()
) -> dict[GraphName, Graph]:
    """The graphs that a recipe asks for, in the order in which they can run.

    Args:
        precision: in place of the recipe's.
        without: inputs and outputs that are left out.
    """
    kind = precision or _TYPES[recipe.export.precision]
    contact, tracking = recipe.contact, recipe.tracking
    contact_graph = ContactGraph(contact.median_px, contact.gross_radius_px, contact.cell_px, contact.stride_px)
    follow = FollowGraph(tracking.window_px, tracking.forward_backward_limit_px)
    key = HeldGraph(KeyGraph(tracking.window_px, tracking.gain_offset), follow.deformation)
    shown = tuple(name for name in FrameResult._fields if name != "real_contact_mask" or contact.real_contact_mask)
    described = {
        "background": (LightGraph(kind), ("background", "dark", "threshold"), Light._fields),
        "contact": (_Measured(contact_graph), ("contact_view", "light", "black"), (*_MEASURED, "threshold")),
        "detect": (
            DetectGraph(tracking.points, tracking.min_distance_px, tracking.window_px, kind),
            ("topography_view", "mask"),
            ("points", "response"),
        ),
        "key": (key, ("topography_view", "points"), (*OF_FRAME, *KeyView._fields)),
        "renew": (
            RenewGraph(tracking.window_px, tracking.gain_offset),
            (*KeyView._fields, "points", "warp"),
            Prepared._fields,
        ),
        "search": (
            SearchGraph(tracking.window_px, tracking.search_px, tracking.forward_backward_limit_px),
            ("key_view", "topography_view", "points", "prediction"),
            ("found",),
        ),
        "track": (follow, ("topography_view", "prediction", *OF_FRAME), Followed._fields),
        "frame": (
            FrameGraph(contact_graph, follow),
            (
                *("contact_view", "topography_view", "topography_to_contact", "prediction"),
                *(*Light._fields, *OF_FRAME),
            ),
            FrameResult._fields,
        ),
        "fields": (
            SinceOnsetGraph(recipe.fields.gauge_length_mm),
            (
                *("points", "covered", "reference", "reached", "entry", "at_entry", "chosen"),
                *("topography_to_contact", "mm_per_px", "center", "semi_axes", "angle"),
            ),
            SinceOnset._fields,
        ),
    }
    graphs = {}
    for name, (module, inputs, outputs) in described.items():
        if name in recipe.export.graphs:
            given = tuple(one for one in inputs if one not in without)
            kept = tuple(one for one in (shown if name == "frame" else outputs) if one not in without)
            graphs[name] = Graph(_Flat(module, outputs, kept, given).eval(), given, kept)
    return graphs
