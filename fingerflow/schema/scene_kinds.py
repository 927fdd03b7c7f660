"""Kinds of scenes: which views each has, and what is computed where nothing is asked for by name."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Kind:
    """A kind of scene.

    Attributes:
        views: tables [views.NAME] that a scene of this kind must have.
        optional_views: those that it may have; the graphs of a stream take them too, so a stream needs them.
        roles: views of other names that are one of these, for stages that ask by that name.
        stages: computed by default, as far as the scene allows them; None for every stage there is.
        without: stages that are computed only where one of their outputs is asked for.
        instead: stages that give what others do, another way.
        optional: tables that other kinds need, and this one does not.
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
        """Whether a stage is among those that are computed by default."""
        return (self.stages is None or stage in self.stages) and stage not in self.without


KINDS = {
    "press": Kind(views=("contact",), optional_views=("topography",), without=("slip",)),
    "slip": Kind(views=("contact",), optional_views=("topography",)),
    # One camera, one light: skin is followed in the picture in which contact is seen.
    "single_view": Kind(views=("camera",), roles={"contact": "camera", "topography": "camera"}, without=("slip",)),
    # A gel with printed markers seen from inside: its own frames tell how it looks at rest.
    "soft_sensor": Kind(
        views=("camera",),
        roles={"contact": "camera", "topography": "camera"},
        without=("slip", "frame_check"),  # at 25 Hz an object that arrives is a jump, and a gel at rest repeats itself
        instead=("marker_contact", "marker_tracking", "marker_displacement"),
        optional=("background",),
        regions=False,
        streamed=False,
    ),
}


def default_kind(values: Mapping[str, Any]) -> str:
    """The kind of a scene file that does not state one: a press, or slip where it has the table of that."""
    return "slip" if "slip" in values else "press"
