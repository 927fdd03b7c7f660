"""Input of a stream: frame source, range of frames, background image (empty glass) and dark image."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fingerflow.engines.bundle import Bundle
from fingerflow.engines.engine import Array
from fingerflow.errors import FingerflowError, PlayerError
from fingerflow.player.live_data import Expected
from fingerflow.player.sources import open_source
from fingerflow.player.sources.camera_source import open_camera
from fingerflow.player.sources.source import OpenSource
from fingerflow.player.sources.synthetic_source import Synthetic, side_by_side
from fingerflow.player.stream_scene import check_scene, load_scene
from fingerflow.schema.scene import Scene
from fingerflow.schema.views import View, negative

_STILLS = 64  # number of averaged frames of the empty glass: the noise is an eighth of that of one frame


class StreamInput(NamedTuple):
    """Input of a stream: scene, frame source, range of frames, background image (empty glass) and dark image.

    ``expected`` returns the true values of a frame from its number, where they are known. ``forces_in`` is the scene
    file that names the forces of these frames. ``size`` is that of the frames with the background, None if only its
    contact view is there.
    """

    scene: Scene
    name: str
    open_source: OpenSource
    glass: Array
    dark: Array
    first: int = 0
    frames: int | None = None
    expected: Expected | None = None
    forces_in: Path | None = None
    size: tuple[int, ...] | None = None


def choose_input(options: argparse.Namespace, bundle: Bundle) -> StreamInput:
    """Choose frame source, range of frames, background and dark image of a stream by the options of the command line;
    raise PlayerError if options and scene conflict.
    """
    if options.camera and options.source:
        raise PlayerError(f"--camera {options.camera} and --source {options.source} exclude each other; keep one")
    synthetic = options.source == "synthetic"
    path = options.scene or (None if synthetic else options.bundle / "scene.toml")
    scene = side_by_side(bundle.height, bundle.width) if path is None else load_scene(path)
    check_scene(scene, bundle, path)
    black = np.zeros((bundle.height, bundle.width), np.float32)
    if synthetic:
        scene = replace(scene, contact=replace(scene.contact, appears="dark"))  # it draws dark contact
        drawn = Synthetic(scene, bundle.dtype, bundle.bit_depth)
        glass = scene.views.contact.crop(drawn.background)
        # The true values hold for the scene of the synthetic source only, not for the views of a scene file.
        expected = drawn.expected_values if path is None else None
        return StreamInput(scene, "synthetic", drawn.frames_from, glass, black, expected=expected)
    recorded, pictures, bright = scene.recording, scene.background, scene.contact.appears == "bright"
    if pictures.frames is None:
        raise PlayerError(
            f"{path}: background.frames is missing; give a file of the empty glass, of one or more frames"
        )
    black_level = None if bright else pictures.dark  # in the difference of two negatives the dark level cancels
    for key, picture in (("frames", pictures.frames), ("dark", black_level)):
        if picture is not None and not picture.exists():
            raise PlayerError(
                f"{path}: {key} of [background] is {picture}, which is not there; record the glass "
                f"{'without light' if key == 'dark' else 'with no finger on it'} and save it under that name, or name "
                "the file that you have"
            )
    (glass, size), (dark, size_of_dark) = (
        (black, None) if file is None else mean_view(file, scene.views.contact, bundle, options.shape, options.dtype)
        for file in (pictures.frames, black_level)
    )
    if size and size_of_dark and size != size_of_dark:
        raise PlayerError(f"{path}: frames of [background] are {size}, those of dark {size_of_dark}; record both alike")
    if bright:
        glass = negative(glass, 2**bundle.bit_depth - 1)
    if options.camera:
        camera = options.camera
        name = camera if isinstance(camera, str) else getattr(camera, "__name__", "camera")
        return StreamInput(scene, name, lambda _: open_camera(camera), glass, dark, size=size)
    file = Path(options.source) if options.source else recorded.frames
    if file is None:
        remedy = f"give --source synthetic, --source FILE or --camera ADDRESS, or state recording.frames in {path}"
        raise PlayerError(f"no source: {remedy}")
    first, frames, forces_in = 0, None, None
    if file.resolve() == recorded.frames:  # range of frames and forces belong to the scene's own recording
        first, forces_in = recorded.first_frame, path if scene.forces is not None else None
        frames = None if recorded.last_frame is None else recorded.last_frame + 1 - first
    return StreamInput(
        *(scene, str(file), lambda number: open_source(file, options.shape, options.dtype, number), glass, dark),
        *(first, frames, None, forces_in, size),
    )


def mean_view(
    path: Path, view: View, bundle: Bundle, shape: tuple[int, int] | None, dtype: str
) -> tuple[Array, tuple[int, ...] | None]:
    """Return the mean image (H, W) float32 of a view over the first 64 frames of a file, such as a recording of the
    empty glass, and the size of its full frames if it has these; `shape` and `dtype` are those of a raw file.

    The frames of the file are full frames, or show this view only.

    Raises PlayerError where the file has no frame, or frames of another size or bit depth than the camera's.
    """
    source = open_source(path, shape, dtype)
    total, count, size = np.zeros(view.shape), 0, None
    try:
        while count < _STILLS and (frame := source.read()) is not None:
            if frame.dtype.kind != "f" and frame.dtype != bundle.dtype:
                raise PlayerError(
                    f"{path}: a frame is {frame.dtype}, the bundle takes {bundle.dtype} (bit_depth "
                    f"{bundle.bit_depth}): grey levels of two depths cannot be compared; record it with the settings "
                    "of the stream"
                )
            if frame.shape != (size := size or frame.shape):
                raise PlayerError(f"{path}: frames are {size} and {frame.shape}; keep those of one size")
            try:
                part = frame if frame.shape == view.shape else view.crop(frame)
            except FingerflowError as error:
                raise PlayerError(f"{path}: {error}; record it with the settings of the stream") from None
            total, count = total + part, count + 1
    finally:
        source.close()
    if not count:
        raise PlayerError(f"{path}: has no frame; one of the empty glass is needed")
    return (total / count).astype(np.float32), None if size == view.shape else size
