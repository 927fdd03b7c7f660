"""Experiment settings of a stream, read from a scene file by the rules of `schema`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fingerflow.engines.bundle import Bundle
from fingerflow.engines.engine import Array
from fingerflow.errors import PlayerError
from fingerflow.schema.region import region_runs
from fingerflow.schema.scene_file import SceneError, read_scene
from fingerflow.schema.views import View
from fingerflow.tracker.frame_tracker import TrackerSettings


@dataclass(frozen=True)
class StreamScene:
    """Experiment settings of a stream: views, scale in mm per px, and background files.

    ``bright_contact`` tells whether skin in contact appears bright: the stream then takes the negative of the contact
    view. Frames are played from `first_frame` to `last_frame` of the recording. ``threshold`` is a number,
    "reference_frame" or "per_frame". ``region`` is the rectangle of the topography view in which points are seeded,
    None for the whole view. ``drawn`` is a region of another shape, as `schema.region` takes it. ``has_forces`` tells
    whether the scene names a file of forces; the package reads it for the page. ``asked`` holds by dotted key the
    settings [contact], [tracking] and [fields] that the scene file states, for comparison with the recipe.
    """

    contact: View
    topography: View
    mm_per_px: float
    topography_to_contact: Array
    bright_contact: bool = False
    threshold: float | str = "reference_frame"
    background: Path | None = None
    dark: Path | None = None
    frames: Path | None = None
    frame_rate: float | None = None
    first_frame: int = 0
    last_frame: int | None = None
    output: Path | None = None
    region: View | None = None
    drawn: Mapping[str, Any] | None = None
    update_share: float | None = None
    update_frames: int | None = None
    has_forces: bool = False
    asked: Mapping[str, Any] = field(default_factory=dict)

    @property
    def given_threshold(self) -> float | None:
        """Return the contact threshold, a relative loss of intensity, that the scene file gives; None if it is to be
        measured.
        """
        return None if isinstance(self.threshold, str) else self.threshold


def stream_settings(scene: StreamScene, bundle: Bundle) -> TrackerSettings:
    """Combine the experiment settings of a scene with number of points, bit depth and view size of a bundle into the
    settings for the tracker of a stream.
    """
    region = np.zeros((bundle.height, bundle.width), dtype=bool)
    if scene.drawn is not None:
        for row, first, end in region_runs(scene.drawn, *region.shape):
            region[row, first:end] = True
    else:
        (scene.region or View((0, bundle.height), (0, bundle.width))).crop(region)[...] = True
    return TrackerSettings(
        points=bundle.points,
        bit_depth=bundle.bit_depth,
        mm_per_px=scene.mm_per_px,
        topography_to_contact=scene.topography_to_contact,
        region=region,
        threshold=scene.given_threshold,
        update_share=scene.update_share,
        update_frames=scene.update_frames,
    )


_DECIDED_BY_RECIPES = ("contact", "tracking", "fields")


def load_scene(path: Path) -> StreamScene:
    """Read the experiment settings of a stream from a scene file.

    Raise PlayerError with file, line, key, value and remedy.
    """
    try:
        checked = read_scene(path, "stream")
    except SceneError as error:
        raise PlayerError(str(error)) from None
    found = checked.values
    views, recording, stream = found["views"], found["recording"], found["stream"]
    for name in ("contact", "topography"):
        if name not in views:
            raise PlayerError(
                f"{path}: its kind is {checked.kind!r}, which has no {name} view; a stream plays scenes of a contact "
                "and a topography view: use `fingerflow process`"
            )
    _check_regions(path, views)
    background = found["background"] or {"frames": None, "dark": None}
    return StreamScene(
        contact=View(views["contact"]["rows"], views["contact"]["columns"]),
        topography=View(views["topography"]["rows"], views["topography"]["columns"]),
        mm_per_px=found["calibration"]["mm_per_px"],
        topography_to_contact=np.array(found["calibration"]["topography_to_contact"]),
        bright_contact=found["contact"]["appears"] == "bright",
        threshold=found["contact"]["threshold"],
        background=background["frames"],
        # In the difference of two negatives the dark level cancels.
        dark=None if found["contact"]["appears"] == "bright" else background["dark"],
        frames=recording["frames"],
        frame_rate=recording["frame_rate"],
        first_frame=recording["first_frame"],
        last_frame=recording["last_frame"],
        output=stream["output"],
        region=None if stream["region"] is None else View(**stream["region"]),
        drawn=views["topography"].get("region"),
        update_share=stream["update_share"],
        update_frames=stream["update_frames"],
        has_forces=found["forces"] is not None,
        asked={
            f"{table}.{key}": value
            for table in _DECIDED_BY_RECIPES
            for key, value in found[table].items()
            if f"{table}.{key}" in checked.given
        },
    )


def _check_regions(path: Path, views: Mapping[str, Any]) -> None:
    """Raise PlayerError if a view of the scene file has a region that streams do not support: any in the contact view,
    one given as a picture in the topography view.
    """
    if views["contact"].get("region") is not None:
        raise PlayerError(
            f"{path}: views.contact.region is of `fingerflow process`; the graphs of a stream look for contact in the "
            "whole view: leave it out, and make rows and columns of the view smaller"
        )
    drawn = views["topography"].get("region")
    if drawn is not None and drawn["mask"] is not None:
        raise PlayerError(
            f"{path}: views.topography.region is a picture, which a stream does not read; draw it as a polygon or an "
            "ellipse"
        )


def check_scene(scene: StreamScene, bundle: Bundle, path: Path | None) -> None:
    """Check that a bundle fits a scene: that read from the scene file at `path` or, without a path, that of the
    synthetic source.

    Raises PlayerError where the views do not have the bundle's size, or where a stream does not support the requested
    threshold or reference.
    """
    size, said = (bundle.height, bundle.width), "" if path is None else f"{path}: "
    for name, view in (("contact", scene.contact), ("topography", scene.topography)):
        if view.shape != size:
            raise PlayerError(
                f"{said}views.{name} of the scene is {view.shape[0]} x {view.shape[1]} px, the bundle was exported for "
                f"{size[0]} x {size[1]}; correct rows and columns, or export one with views of that size"
            )
    if scene.threshold == "per_frame":
        raise PlayerError(
            f"{said}contact.threshold of the scene is 'per_frame'; a stream computes each frame with a threshold that "
            'is known before it comes: give a number, such as 0.25, or "reference_frame", which is measured while the '
            "contact grows; `fingerflow process` of the recording takes one of each frame"
        )
    since = scene.asked.get("fields.reference", "onset")
    if since != "onset":
        raise PlayerError(
            f"{said}fields.reference of the scene is {since!r}; the graphs of a stream count displacement from each "
            "point's own onset of contact: leave the key out, or take 'onset'; `fingerflow process` of the recording "
            "counts from any frame"
        )


_PLAYED = {  # settings with a fixed value in a stream, because later frames are unknown or graphs are fixed
    "tracking.direction": "forward",
    "tracking.points_from": "recorded",
    "tracking.template": "keyframe",
    "fields.strain": "green_lagrange",
}


def contradictions(scene: StreamScene, recipe: Mapping[str, Any]) -> list[str]:
    """Return one sentence for each setting of a scene file that differs from the export recipe of the bundle."""
    decided = {f"{table}.{key}": value for table, keys in recipe.items() for key, value in keys.items()} | _PLAYED
    return [
        f"{name} of the scene is {value!r}; the bundle plays with {decided[name]!r}"
        for name, value in scene.asked.items()
        if name in decided and value != decided[name]
    ]
