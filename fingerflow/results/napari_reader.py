"""Reader plug-in of napari: a recording as an image layer, a result as images, tracks and points."""

import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.recordings import Recording, open_recording
from fingerflow.results.result import is_result, load_result
from fingerflow.results.tables.archives import is_zarr_result
from fingerflow.results.tables.columns import track_table
from fingerflow.schema.scene import Scene, scene_of_settings
from fingerflow.schema.variables import VARIABLES
from fingerflow.schema.views import View

Layer = tuple[Any, dict[str, Any], str]  # data, settings and kind of a layer, as napari's `Viewer.add_layer` takes them
#: Colour map of signed quantities, by its name in matplotlib and napari: spread (positive) is red.
DIVERGING = "RdBu_r"
_COLOURED = 0.98  # quantile of the absolute values that limits the colour scale


def get_reader(path: str | list[str]) -> Callable[[str], list[Layer]] | None:
    """Return a function that reads `path` as napari layers; None for a path that is neither recording nor result."""
    if not isinstance(path, str):
        return None
    file = Path(path)
    if is_zarr_result(file) or (file.is_file() and is_result(file)):
        return layers_of_result
    try:
        open_recording(path).close()
    except FingerflowError:
        return None
    return layers_of_recording


def layers_of_recording(path: str) -> list[Layer]:
    """Return the image layer (frame, y, x) of a recording, whose frames are read when they are shown."""
    recording = open_recording(path)
    return [_image(recording, View((0, recording.frame_shape[0]), (0, recording.frame_shape[1])), Path(path).stem)]


def layers_of_result(path: str) -> list[Layer]:
    """Return the napari layers of a result file: images of the recorded views, tracks of the skin points, and the
    points coloured by the divergence of their displacement.

    All are in px of the topography view; the first axis counts the frames of the result from 0. Views are left out if
    the recording is not there any more.
    """
    result = load_result(Path(path))
    layers: list[Layer] = []
    with suppress(FingerflowError):  # the recording, or a file of the scene, may be missing
        layers += _views(result, scene_of_settings(result.attrs["settings"]))
    if "position_px" not in result:
        return layers
    shown = [name for name in ("divergence", "curl", "subset_correlation") if name in result]
    table = track_table(result, shown)
    rows = np.column_stack(list(table.values()))
    rows[:, 1] -= float(result["frame"][0])
    layers.append((rows[:, :4], {"name": "tracks", "visible": False}, "tracks"))
    features = {name: rows[:, 4 + k] for k, name in enumerate(list(table)[4:])}
    points = {"name": "points", "size": 4, "border_width": 0, "face_color": "#ffd54f"}
    if "divergence" in shown:
        heading = VARIABLES["divergence"].shown_unit.heading("divergence")
        valid = np.isfinite(features[heading])
        rows, features = rows[valid], {name: values[valid] for name, values in features.items()}
        end = float(np.quantile(np.abs(features[heading]), _COLOURED)) if valid.any() else 1.0
        points |= {"name": heading, "face_color": heading}
        points |= {"face_colormap": DIVERGING, "face_contrast_limits": (-end, end)}
    layers.append((rows[:, 1:4], {**points, "features": features}, "points"))
    return layers


def _views(result: xr.Dataset, scene: Scene) -> list[Layer]:
    recording = open_recording(scene.recording.frames, frame_rate=scene.recording.frame_rate)
    first = scene.recording.first_frame
    frames = recording[first : first + result.sizes["frame"]]
    contact, topography = scene.views.get("contact"), scene.views.topography
    layers = []
    if contact is not None and contact != topography:
        data, settings, layer_type = _image(frames, contact, "contact view")
        to_contact = np.vstack((json.loads(result.attrs["topography_to_contact"]), (0, 0, 1)))
        affine = np.eye(4)
        # Axes in napari's order (y, x) instead of (x, y).
        affine[1:, 1:] = np.linalg.inv(to_contact)[np.ix_((1, 0, 2), (1, 0, 2))]
        layers.append((data, {**settings, "affine": affine, "visible": topography is None}, layer_type))
    if topography is not None:
        layers.append(_image(frames, topography, "topography view"))
    return layers


def _image(frames: Recording, view: View, name: str) -> Layer:
    most = 1.0 if frames.bit_depth is None else 2.0**frames.bit_depth - 1
    about = {"name": name, "contrast_limits": (0.0, most), "metadata": {"frame_rate_hz": frames.frame_rate}}
    return FramesOnDemand(frames, view), about, "image"


class FramesOnDemand:
    """Array-like object (frame, y, x) of one view of a recording, which reads each frame from the file when it is
    indexed.
    """

    ndim = 3

    def __init__(self, frames: Recording, view: View) -> None:
        self._frames, self._view = frames, view
        self.shape, self.dtype = (len(frames), *view.shape), frames.dtype
        self.size = int(np.prod(self.shape))

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, key: Any) -> NDArray[Any]:
        first, *rest = key if isinstance(key, tuple) else (key,)
        numbers = np.arange(len(self))[first]
        pictures = self._view.crop(self._frames[np.atleast_1d(numbers)].read())
        return pictures[0][tuple(rest)] if np.ndim(numbers) == 0 else pictures[(slice(None), *rest)]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self[:], dtype)
