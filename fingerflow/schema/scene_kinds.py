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
        without: stages that are computed only where one of their outputs is requested.
    """

    views: tuple[str, ...]
    optional_views: tuple[str, ...] = ()
    roles: Mapping[str, str] = field(default_factory=dict)
    without: tuple[str, ...] = ()

    @property
    def all_views(self) -> tuple[str, ...]:
        """Return the names of all views that a scene of this kind must or may have."""
        return self.views + self.optional_views


KINDS = {
    "press": Kind(views=("contact",), optional_views=("topography",), without=("slip",)),
    "slip": Kind(views=("contact",), optional_views=("topography",)),
    # One camera and one light: skin is tracked in the image that shows the contact.
    "single_view": Kind(views=("camera",), roles={"contact": "camera", "topography": "camera"}, without=("slip",)),
}


def default_kind(values: Mapping[str, Any]) -> str:
    """Return the kind of a scene file that states no kind: "slip" with a table [slip], else "press"."""
    return "slip" if "slip" in values else "press"
