"""Kinds of scenes, such as "press" and "slip", which determine the views and the stages that run by default."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Kind:
    """Kind of experiment that a scene file describes, which determines its views and the processing stages that run by
    default.

    Attributes:
        views: tables [views.NAME] that a scene of this kind must have.
        optional_views: tables [views.NAME] that it may have; a stream requires them, because its graphs take them.
        roles: view names that stages use, mapped to the view of this kind that takes that role.
        stages: computed by default, as far as the settings of the scene allow; None for all stages.
        without: stages that are computed only where one of their outputs is requested.
        instead: alternative implementations, stages that replace those with the same outputs.
        optional: tables that other kinds need and this kind does not.
        regions: whether [views.NAME] may have a region.
        streamed: whether the graphs of a stream can play it.
    """

    views: tuple[str, ...]
    optional_views: tuple[str, ...] = ()
    roles: Mapping[str, str] = field(default_factory=dict)
    stages: tuple[str, ...] | None = None
    without: tuple[str, ...] = ()
    instead: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    regions: bool = True
    streamed: bool = True

    def computes(self, stage: str) -> bool:
        """Return whether scenes of this kind run a given stage by default."""
        return (self.stages is None or stage in self.stages) and stage not in self.without


KINDS = {
    "press": Kind(views=("contact",), optional_views=("topography",), without=("slip",)),
    "slip": Kind(views=("contact",), optional_views=("topography",)),
    # One camera and one light: skin is tracked in the image that shows the contact.
    "single_view": Kind(views=("camera",), roles={"contact": "camera", "topography": "camera"}, without=("slip",)),
    # A gel with printed markers, seen from inside: frames of the recording itself show the gel at rest.
    "soft_sensor": Kind(
        views=("camera",),
        roles={"contact": "camera", "topography": "camera"},
        # At 25 Hz an arriving object looks like a jump and a gel at rest like repeated frames.
        without=("slip", "frame_check"),
        instead=("marker_contact", "marker_tracking", "marker_displacement"),
        optional=("background",),
        regions=False,
        streamed=False,
    ),
}


def default_kind(values: Mapping[str, Any]) -> str:
    """Return the kind of a scene file that states no kind: "slip" with a table [slip], else "press"."""
    return "slip" if "slip" in values else "press"
