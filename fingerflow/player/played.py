"""What is played: a source, which of its frames count, and the pictures of the empty glass."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .arrays import Array
from .background import mean_view
from .bundle import Bundle
from .errors import PlayerError
from .scene import Scene, check_scene, load_scene
from .sources import open_recording
from .sources.camera import open_camera
from .sources.source import OpenSource
from .sources.synthetic import Synthetic, side_by_side


class Played(NamedTuple):
    """What is played: a source by name, which of its frames count, the contact views of empty glass and darkness."""

    scene: Scene
    name: str
    open_source: OpenSource
    glass: Array
    dark: Array
    first: int = 0
    frames: int | None = None


def played_by(options: argparse.Namespace, bundle: Bundle) -> Played:
    """What the options of the command line ask for; raises PlayerError where they or the scene do not go together."""
    if options.camera and options.source:
        raise PlayerError(f"--camera {options.camera} and --source {options.source} exclude each other; keep one")
    shape = None if options.shape is None else (options.shape[0], options.shape[1])
    synthetic = options.source == "synthetic"
    path = options.scene
    if path is None and not synthetic:
        path = options.bundle / "scene.toml"
    scene = side_by_side(bundle.height, bundle.width) if path is None else load_scene(path)
    check_scene(scene, bundle)
    black = np.zeros((bundle.height, bundle.width), np.float32)
    if synthetic:
        drawn = Synthetic(scene, bundle.dtype, bundle.bit_depth)
        return Played(scene, "synthetic", drawn.from_frame, scene.contact.crop(drawn.background), black)
    if scene.background is None:
        raise PlayerError(
            f"{path}: background.frames is missing; give a file of the empty glass, of one or more frames"
        )
    glass, dark = (
        black if file is None else mean_view(file, scene.contact, bundle, shape, options.dtype)
        for file in (scene.background, scene.dark)
    )
    if options.camera:
        return Played(scene, options.camera, lambda _: open_camera(options.camera), glass, dark)
    file = Path(options.source) if options.source else scene.frames
    if file is None:
        raise PlayerError(
            "no source: give --source synthetic, --source FILE or --camera MODULE:FACTORY, or state recording.frames "
            f"in {path}"
        )
    first, frames = 0, None
    if file.resolve() == scene.frames:  # the range is that of the scene's own recording
        first = scene.first_frame
        frames = None if scene.last_frame is None else scene.last_frame + 1 - first
    return Played(
        scene, str(file), lambda number: open_recording(file, shape, options.dtype, number), glass, dark, first, frames
    )
