"""Trials that are small enough for a test, and the ways in which tests spoil their frames."""

import json
import tomllib
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import xarray as xr

from fingerflow import load_scene
from fingerflow.engines.check import expected_of
from fingerflow.engines.engine import Array
from fingerflow.engines.native import NativeEngine
from fingerflow.export import export_bundle
from fingerflow.export.write_bundle import write_facts
from fingerflow.schema.recipe import GRAPHS, Recipe, parse_recipe
from fingerflow.schema.scene import Scene
from fingerflow.synthetic import PartialSlip, Press, Slide, write_recording
from fingerflow.synthetic.scenes import SyntheticScene

#: 8 frames of 96 x 240 px: contact in the last six.
TINY_PRESS = Press(
    n_frames=8, frame_rate=8.0, frames_before_trigger=1, frame_shape=(96, 240), finger=(1.8, 1.5), semi_axes=(1.3, 1.1)
)

_SMALL: dict[str, Any] = {"frame_shape": (192, 480), "finger": (3.2, 2.7), "semi_axes": (2.3, 1.9)}
#: A trial of slip and a press of 16 frames in views of 192 x 240 px, for `write_small`.
SMALL_SLIP: dict[str, Any] = {**_SMALL, "creep": 0.45, "travel": 0.8}
SMALL_PRESS = Press(n_frames=16, frame_rate=16.0, frames_before_trigger=1, **_SMALL)

# Trials on which a stream and `process` are compared.
FRAMES, HEIGHT, WIDTH, POINTS = 72, 192, 240, 150
_SHARED = f"""
[tracking]
points = {POINTS}
window_px = 21
[fields]
gauge_length_mm = 1.6
"""
_SHAPE: dict[str, Any] = {"n_frames": FRAMES, "frame_shape": (HEIGHT, 2 * WIDTH), "semi_axes": (2.1, 1.7)}
TRIALS: dict[str, Press | Slide] = {
    "press": Press(**_SHAPE, rise_time=0.2, finger=(2.9, 2.4)),
    "slide": Slide(**_SHAPE, finger=(2.9, 2.4)),
}


def turned(frames: Array, degrees: float, half_period: int = 3) -> Array:
    """Return frames (F, H, W) of a camera that turns to and fro, by `degrees` at most, once in two half periods."""
    result = np.empty_like(frames)
    for k, frame in enumerate(frames):
        rows, columns = frame.shape
        matrix = cv2.getRotationMatrix2D((columns / 2, rows / 2), degrees * np.sin(k * np.pi / half_period), 1)
        cv2.warpAffine(frame, matrix, (columns, rows), result[k], cv2.INTER_CUBIC, cv2.BORDER_REPLICATE)
    return result


def write_small(folder: Path, trial: SyntheticScene) -> Path:
    """Write a recording of a small contact, with a scene file with windows that fit it and without settings of streams;
    return the path of the scene file.
    """
    write_recording(folder, trial)
    scene = folder / "scene.toml"
    edit(scene, ("window_px = 25", "window_px = 15"), ("min_distance_px = 6.0", "min_distance_px = 4.0"))
    text = scene.read_text(encoding="utf-8")
    scene.write_text(text[: text.index("[stream]")], encoding="utf-8")
    return scene


def edit(path: Path, *changes: tuple[str, str]) -> None:
    """Replace the first occurrence of each text in a file; each must occur."""
    text = path.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    path.write_text(text, encoding="utf-8")


def write_trial(folder: Path, kind: str = "press") -> Path:
    """Write the recording and the scene file of a trial, with a given threshold and the settings of the bundle; return
    the path of the scene file.
    """
    return write_scene_of_bundle(folder, TRIALS[kind])


def write_small_slip(folder: Path, **settings: Any) -> Path:
    """Write a trial with the settings of `SMALL_SLIP` and windows that fit a small contact; its scene does not say
    where skin touches.

    Return its folder.
    """
    return write_small(folder, PartialSlip(**(SMALL_SLIP | settings))).parent


def write_scene_of_bundle(folder: Path, trial: SyntheticScene) -> Path:
    """Write the recording of any trial with views of `HEIGHT` x `WIDTH` px, and its scene file as `write_trial` does;
    return the path of the scene file.
    """
    write_recording(folder, trial)
    scene = folder / "scene.toml"
    text = scene.read_text(encoding="utf-8")
    settings = f"[contact]\nthreshold = 0.27\n{_SHARED}"
    scene.write_text(text[: text.index("[contact]")] + settings + text[text.index("[stream]") :], encoding="utf-8")
    return scene


def write_bundle_of_trials(folder: Path) -> Path:
    """Export all graphs for these trials, and write the results of their verification beside the bundle; return the
    folder of the bundle.
    """
    recipe, verification = beside(folder)
    views = f"[views]\nheight = {HEIGHT}\nwidth = {WIDTH}\n"
    recipe.write_text(f"{views}{_SHARED}[export]\ngraphs = {json.dumps(GRAPHS)}\n", encoding="utf-8")
    verification.write_text(json.dumps(export_bundle(recipe, folder)), encoding="utf-8")
    return folder


def write_library_bundle(folder: Path, recipe: Recipe) -> Path:
    """Write a bundle that the compiled library plays, without exporting graphs, which takes a minute; return its
    folder.

    The files of its graphs are no graphs; the numbers of its built-in frame are those of the compiled library here.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name in GRAPHS:
        (folder / f"{name}.onnx").write_text(f"no graph, {name}")
    settings = asdict(recipe)
    size: dict[str, int] = {one: settings["views"][one] for one in ("height", "width", "bit_depth")}
    expected = expected_of(NativeEngine(recipe.engine_settings), **size, points=recipe.tracking.points)
    write_facts(settings, expected, folder)
    return folder


def recipe_of_trials() -> Recipe:
    """Return the recipe of a bundle that plays these trials."""
    return parse_recipe({"views": {"height": HEIGHT, "width": WIDTH}, **tomllib.loads(_SHARED)})


def edit_scene(folder: Path, replaced: dict[str, str], name: str = "scene.toml", stream: bool = True) -> Path:
    """Write a scene of a recording with texts replaced, and without its last table, [stream], unless `stream`; return
    its path.
    """
    text = (folder / "scene.toml").read_text(encoding="utf-8")
    for old, new in replaced.items():
        assert old in text, old
        text = text.replace(old, new)
    (folder / name).write_text(text if stream else text[: text.index("[stream]")], encoding="utf-8")
    return folder / name


def scene_beside(
    recording: Path,
    folder: Path,
    replaced: dict[str, str] | None = None,
    *,
    forces: bool = True,
    stream: bool = True,
    **arrays: Array,
) -> Scene:
    """Write the scene of a recording to another folder, with texts replaced, and with other arrays in place of its
    files; return the scene.
    """
    text = (recording / "scene.toml").read_text(encoding="utf-8")
    for name in ("frames.npy", "empty.npy", "dark.npy", "forces.csv"):
        text = text.replace(f'"{name}"', f'"{(recording / name).as_posix()}"')
    for name, values in arrays.items():
        np.save(folder / f"{name}.npy", values)
        text = text.replace(f'"{(recording / name).as_posix()}.npy"', f'"{name}.npy"')
    if not forces:
        first = text.index("[forces]")
        text = text[:first] + text[text.index("\n[", first) + 1 :]
    (folder / "scene.toml").write_text(text, encoding="utf-8")
    return load_scene(edit_scene(folder, replaced or {}, stream=stream))


def warnings_of(result: xr.Dataset) -> str:
    """Return the warnings of a result, one a line."""
    return "\n".join(json.loads(result.attrs["warnings"]))


def beside(bundle: Path) -> tuple[Path, Path]:
    """Return the paths of the recipe of a bundle and of its verification."""
    return bundle.with_name(f"{bundle.name}.toml"), bundle.with_name(f"{bundle.name}.json")


def _torn(frame: Array) -> Array:
    half = len(frame) // 2
    return np.concatenate([frame[:half], np.roll(frame[half:], 25, axis=1)])


def _without_lines(frame: Array) -> Array:
    return np.where((np.arange(len(frame)) // 10 % 20 == 9)[:, None], 0, frame).astype(frame.dtype)


def dim_contact(frame: Array) -> Array:
    """Return the frame with the contact view, on the right, at 70 % of its light."""
    middle = frame.shape[1] // 2
    return np.concatenate([frame[:, :middle], (0.7 * frame[:, middle:]).astype(frame.dtype)], axis=1)


#: Functions that spoil a frame (H, W) of 8 bits, and the status of the spoiled frame.
SPOILED: dict[str, tuple[Callable[[Array], Array], str]] = {
    "black": (lambda frame: np.full_like(frame, 8), "dark"),
    "saturated": (lambda frame: np.full_like(frame, 255), "saturated"),
    "dim contact view": (dim_contact, "jumps_and_returns"),
    "brighter": (lambda frame: np.minimum(1.4 * frame, 255).astype(frame.dtype), "jumps_and_returns"),
    "rolled": (lambda frame: np.roll(frame, 7 * len(frame) // 12, axis=0), "jumps_and_returns"),
    "shifted": (lambda frame: np.roll(frame, 15, axis=1), "jumps_and_returns"),
    "torn": (_torn, "jumps_and_returns"),
    "lines lost": (_without_lines, "jumps_and_returns"),
}
