"""Experiment settings of a stream, read from a scene file by the rules of `schema`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fingerflow.engines.bundle import Bundle
from fingerflow.errors import FingerflowError, PlayerError
from fingerflow.recordings.drawn_region import drawn_mask
from fingerflow.recordings.lens import Geometry
from fingerflow.schema import scene as scenes
from fingerflow.schema.scene import Scene, check_scale
from fingerflow.schema.views import Rectangle, View
from fingerflow.tracker.frame_tracker import TrackerSettings


def find_topography(scene: Scene) -> View:
    """Return the topography view, which the scene of every stream has."""
    view = scene.views.topography
    assert view is not None
    return view


def stated_threshold(scene: Scene) -> float | None:
    """Return the contact threshold, a relative loss of intensity, that the scene file states; None if it is to be
    measured.
    """
    threshold = scene.contact.threshold
    return None if isinstance(threshold, str) else threshold


def stream_settings(scene: Scene, bundle: Bundle) -> TrackerSettings:
    """Combine the experiment settings of a scene with number of points, bit depth and view size of a bundle into the
    settings for the tracker of a stream.
    """
    topography = find_topography(scene)
    region, drawn = np.zeros((bundle.height, bundle.width), dtype=bool), topography.region
    if drawn is not None:
        region = drawn_mask(drawn, region.shape)
    else:
        (scene.stream.region or Rectangle((0, bundle.height), (0, bundle.width))).crop(region)[...] = True
    return TrackerSettings(
        points=bundle.points,
        bit_depth=bundle.bit_depth,
        geometry=Geometry(scene.calibration, scene.views.contact, topography),
        region=region,
        threshold=stated_threshold(scene),
        update_share=scene.stream.update_share,
        update_frames=scene.stream.update_frames,
    )


def load_scene(path: Path) -> Scene:
    """Read the experiment settings of a stream from a scene file.

    Raise PlayerError with file, line, key, value and remedy, also if a view has a region that streams do not support:
    any in the contact view, one given as a picture in the topography view.
    """
    try:
        scene = scenes.load_scene(path, "stream")
    except FingerflowError as error:
        raise PlayerError(str(error)) from None
    for name in ("contact", "topography"):
        if name not in scene.views:
            remedy = "a stream plays scenes of a contact and a topography view: use `fingerflow process`"
            raise PlayerError(f"{path}: its kind is {scene.kind!r}, which has no {name} view; {remedy}")
    if scene.views.contact.region is not None:
        raise PlayerError(
            f"{path}: views.contact.region is of `fingerflow process`; the graphs of a stream look for contact in the "
            "whole view: leave it out, and make rows and columns of the view smaller"
        )
    drawn = find_topography(scene).region
    if drawn is not None and drawn.mask is not None:
        remedy = "draw it as a polygon or an ellipse"
        raise PlayerError(f"{path}: views.topography.region is a picture, which a stream does not read; {remedy}")
    return scene


def check_scene(scene: Scene, bundle: Bundle, path: Path | None) -> None:
    """Check that a bundle fits a scene: that read from the scene file at `path` or, without a path, that of the
    synthetic source.

    Raises PlayerError where the views do not have the bundle's size, or where a stream does not support the requested
    threshold or reference.
    """
    size, file = (bundle.height, bundle.width), "" if path is None else f"{path}: "
    for name, view in (("contact", scene.views.contact), ("topography", find_topography(scene))):
        if view.shape != size:
            raise PlayerError(
                f"{file}views.{name} of the scene is {view.shape[0]} x {view.shape[1]} px, the bundle was exported for "
                f"{size[0]} x {size[1]}; correct rows and columns, or export one with views of that size"
            )
    if scene.contact.threshold == "per_frame":
        raise PlayerError(
            f"{file}contact.threshold of the scene is 'per_frame'; a stream computes each frame with a threshold that "
            'is known before it comes: give a number, such as 0.25, or "reference_frame", which is measured while the '
            "contact grows; `fingerflow process` of the recording takes one of each frame"
        )
    since = scene.fields.reference
    if since != "onset":
        raise PlayerError(
            f"{file}fields.reference of the scene is {since!r}; the graphs of a stream count displacement from each "
            "point's own onset of contact: leave the key out, or take 'onset'; `fingerflow process` of the recording "
            "counts from any frame"
        )


_PLAYED = {  # settings with a fixed value in a stream, because later frames are unknown or graphs are fixed
    "tracking.direction": "forward",
    "tracking.points_from": "recorded",
    "tracking.template": "keyframe",
    "fields.strain": "green_lagrange",
}


def contradictions(scene: Scene, recipe: Mapping[str, Any]) -> list[str]:
    """Return one sentence for each setting of a scene file that differs from the export recipe of the bundle, and for
    an image scale that is none of a fingertip.
    """
    decided = {f"{table}.{key}": value for table, keys in recipe.items() for key, value in keys.items()} | _PLAYED
    sentences = [*check_scale(scene)]
    for name in sorted(scene.given & decided.keys()):
        table, _, key = name.partition(".")
        value = getattr(getattr(scene, table), key)
        if value != decided[name]:
            sentences.append(f"{name} of the scene is {value!r}; the bundle plays with {decided[name]!r}")
    return sentences
