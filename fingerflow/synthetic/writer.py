"""Writing of a synthetic scene as a lab recording, with the settings that rebuild its ground truth."""

import dataclasses
import json
import os
import shutil
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from fingerflow.errors import FingerflowError
from fingerflow.schema.scene_template import scene_text
from fingerflow.schema.text_file import read_text
from fingerflow.schema.unfinished import unfinished as hidden
from fingerflow.schema.views import View
from fingerflow.synthetic.frame_threads import each_frame
from fingerflow.synthetic.partial_slip import PartialSlip
from fingerflow.synthetic.scenes import SyntheticScene

FILE = "File"
REFERENCE_PICTURES = 8
_REGION_FRAMES = 12  # number of frames whose contacts determine the region
FORCE_COLUMNS = "time (s),normal_force (N),tangential_force (N),trigger (V)"


def write_recording(folder: Path, scene: SyntheticScene, progress: bool = True) -> None:
    """Write a synthetic scene as a recording folder, which appears only when it is complete, with a progress bar.

    The folder holds frames.npy (frames, H, W) in the camera's integers; empty.npy and dark.npy (H, W) float32, each the
    mean of eight images without a finger and without light; forces.csv at 10 kHz, seconds from the trigger; scene.toml,
    the experiment settings; truth.json, from which `rebuild_scene` rebuilds the scene and its truth; and the image of
    the print if the skin is one.

    Raises FingerflowError if the folder exists already or cannot be made.
    """
    folder = Path(folder)
    if folder.exists():
        raise FingerflowError(f"{folder} exists already; remove it or name another folder for the synthetic recording")
    unfinished = hidden(folder)
    try:
        unfinished.mkdir(parents=True)
        _write_frames(unfinished / "frames.npy", scene, progress)
        for name, picture in (("empty", scene.empty), ("dark", scene.dark)):
            mean = np.mean([picture(number) for number in range(REFERENCE_PICTURES)], axis=0, dtype=np.float64)
            np.save(unfinished / f"{name}.npy", mean.astype(np.float32))
        columns = np.stack(scene.forces(), axis=1)
        np.savetxt(unfinished / "forces.csv", columns, fmt="%.6f", delimiter=",", header=FORCE_COLUMNS, comments="")
        (unfinished / "scene.toml").write_text(_scene_text(scene), encoding="utf-8")
        (unfinished / "truth.json").write_text(_truth_text(scene, unfinished), encoding="utf-8")
        unfinished.rename(folder)
    except BaseException as error:
        shutil.rmtree(unfinished, ignore_errors=True)
        if isinstance(error, OSError):
            raise FingerflowError(
                f"{folder} cannot be written ({error.strerror or error}); make room there, or name another place"
            ) from error
        raise


def rebuild_scene(folder: Path) -> SyntheticScene:
    """Return the scene that `write_recording` wrote into a folder; it has the same frames and ground truth.

    Raises FingerflowError if truth.json is missing or does not describe a scene.
    """
    path = Path(folder) / "truth.json"
    text = read_text(path, "only a synthetic recording has a truth to rebuild")
    try:
        scene = json.loads(text, object_hook=partial(_rebuild_part, path.parent))
    except (ValueError, TypeError, KeyError) as error:
        raise FingerflowError(f"{path} does not describe a synthetic scene of this version ({error!r})") from error
    if not isinstance(scene, SyntheticScene):
        raise FingerflowError(f"{path} holds a {type(scene).__name__}, not a Press, ChainPress, Slide or PartialSlip")
    return scene


def _write_frames(path: Path, scene: SyntheticScene, progress: bool) -> None:
    first = scene.render(0)
    frames = np.lib.format.open_memmap(path, mode="w+", dtype=first.dtype, shape=(scene.n_frames, *first.shape))
    if hasattr(os, "posix_fallocate"):
        # Reserve the space first: on a full disk, writing to mapped memory would end the process by SIGBUS.
        with path.open("r+b") as file:
            os.posix_fallocate(file.fileno(), 0, path.stat().st_size)

    def write(number: int) -> None:
        frames[number] = scene.render(number)

    with closing(each_frame(write, range(scene.n_frames))) as written:
        for _ in tqdm(written, total=scene.n_frames, desc="synthetic frames", unit="frame", disable=not progress):
            pass
    frames.flush()


def _scene_text(scene: SyntheticScene) -> str:
    matrix = np.asarray(scene.topography_to_contact, np.float64).tolist()  # numbers of NumPy have another `repr`
    return scene_text(
        frames="frames.npy",
        frame_rate=scene.frame_rate,
        trigger_frame=scene.frames_before_trigger,
        background="empty.npy",
        dark="dark.npy",
        contact=scene.views["contact"],
        topography=scene.views["topography"],
        forces="forces.csv",
        calibration=f"mm_per_px = {scene.mm_per_px}\ntopography_to_contact = {matrix}",
        region=_region_of_skin(scene),
        slip=isinstance(scene, PartialSlip),
    )


def _region_of_skin(scene: SyntheticScene) -> View | None:
    """Return the rectangle of the topography view that contains, in frame 0, all skin that touches the glass later."""
    truth, edges = scene.truth, []
    for frame in np.unique(np.linspace(0, scene.n_frames - 1, _REGION_FRAMES).astype(int)):
        if (ellipse := truth.ellipse(int(frame))) is not None:
            edges.append(truth.topography_pixels(truth.positions(truth.material(ellipse.edge(63), int(frame)), 0)))
    if not edges:
        return None
    height, width = scene.views["topography"].shape
    low, high = np.floor(np.concatenate(edges).min(0)), np.ceil(np.concatenate(edges).max(0))
    (left, top), (right, bottom) = low.clip(0).astype(int), high.clip(0, (width, height)).astype(int)
    return View((int(top), int(bottom)), (int(left), int(right))) if left < right and top < bottom else None


def _truth_text(scene: SyntheticScene, folder: Path) -> str:
    """Return the settings of a scene as JSON text, and copy an image file named in them to the recording's folder."""

    def settings(part: Any) -> dict[str, Any]:
        if isinstance(part, Path):
            shutil.copyfile(part, folder / f"print{part.suffix}")
            return {"kind": FILE, "name": f"print{part.suffix}"}
        arguments = {field.name: getattr(part, field.name) for field in dataclasses.fields(part) if field.init}
        return {"kind": type(part).__name__, **arguments}

    return json.dumps(scene, default=settings, indent=1)


def _rebuild_part(folder: Path, settings: dict[str, Any]) -> Any:
    if settings["kind"] == FILE:
        return folder / settings["name"]
    from fingerflow import synthetic  # which imports this module

    part: Any = getattr(synthetic, settings["kind"], None)
    if not hasattr(part, "__dataclass_fields__"):
        raise KeyError(settings["kind"])
    return part(**{name: _to_tuples(value) for name, value in settings.items() if name != "kind"})


def _to_tuples(value: Any) -> Any:
    """Convert lists from JSON to tuples, recursively, as the settings of scenes are tuples."""
    return tuple(_to_tuples(item) for item in value) if isinstance(value, list) else value
