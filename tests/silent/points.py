"""Cases that make tracked points wrong: dust on the glass, defective pixels, lossy video, and a second touch.

For dust and pixels, the number is the share of accepted positions that are wrong by more than 0.5 px and four
deviations, and the difference of the strain energy from the clean recording in deviations. A share below 0.1 % is
right; a larger share, or NaN, needs a warning that names the cause. For touches the number is the median divergence,
um/mm, in the last frame. Recordings without a fault must lose no point and give no new warning.
"""

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from bench.prints import DPI, FINGERS
from bench.recordings import write_quietly
from fingerflow import load_scene, process
from fingerflow.engines.engine import Array
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.schema.scene import Scene
from fingerflow.synthetic import Press, Slide, SyntheticScene, scene_of_print
from fingerflow.synthetic.texture import RidgeTexture
from tests.recordings.camera_files import write_video
from tests.silent.case import Case, without_fault
from tests.silent.contact import PRESS
from tests.silent.deviation_scenes import scenes
from tests.small_trials import scene_beside, warnings_of

OUTPUTS = ["position_px", "position_std_px", "status", "strain_energy", "strain_energy_std", "median_divergence",
    "median_divergence_std", "field_coverage", "in_contact"]  # fmt: skip
WRONG_PX, DEVIATIONS, MOST_WRONG = 0.5, 4.0, 1e-3
_LOOKS = 24  # frames
_DARK, _RADII = 0.5, (1.5, 3.0)  # share of the light, and px
_AWAY = 90  # px, distance of each of two touches from the middle


def cases(few: bool = False) -> Iterator[Case]:
    """Yield dust, defective pixels and touches, of half the frames if `few`, else recordings without a fault too."""
    count = 50 if few else 100
    size: dict[str, Any] = {"n_frames": count, "frame_rate": float(count), "frames_before_trigger": count // 25}
    trials: dict[str, SyntheticScene] = {"press": Press(**size), "slide": Slide(**size)}
    for name, trial in trials.items():
        with tempfile.TemporaryDirectory() as folder:
            recording = Path(folder) / "clean"
            write_quietly(recording, trial)
            yield from _spoiled(name, trial, recording)
    yield second_touch()
    if few:
        return
    trials = {"press": Press(), "slide": Slide()}
    for path in sorted(FINGERS.glob("*.tif")):
        press = replace(scene_of_print(Press, path, DPI), n_frames=60, frame_rate=60.0, frames_before_trigger=3)
        trials[f"press of {path.stem}"] = press
    trials |= {name: scene for name, scene in scenes() if isinstance(scene, Press)}
    for name, trial in trials.items():
        with tempfile.TemporaryDirectory() as folder:
            write_quietly(Path(folder) / "trial", trial)
            yield without_fault(name, process(Path(folder) / "trial" / "scene.toml"))


class Spoiled(NamedTuple):
    """Arrays that replace the files of a recording, and words of the warning that names the cause."""

    case: str
    arrays: dict[str, Array]
    cause: str


def _spoiled(name: str, trial: SyntheticScene, recording: Path) -> Iterator[Case]:
    """Yield the cases of a trial with spoiled frames."""
    right = process(recording / "scene.toml", OUTPUTS)
    for one in _spoilings(trial, recording):
        with tempfile.TemporaryDirectory() as folder:
            result = process(scene_beside(recording, Path(folder), **one.arrays), OUTPUTS)
        yield judged(f"{name}: {one.case}", trial, result, right, one.cause)
    with tempfile.TemporaryDirectory() as folder:
        result = process(_encoded(recording, Path(folder)), OUTPUTS)
    yield judged(f"{name}: H.264, crf 28", trial, result, right, "h264")


def _spoilings(trial: SyntheticScene, recording: Path) -> Iterator[Spoiled]:
    frames = np.load(recording / "frames.npy")
    black, empty = (np.load(recording / f"{name}.npy").astype(np.float32) for name in ("dark", "empty"))
    for count in (60, 300):
        share = specks(trial, count)
        dusty = np.stack([np.clip((one - black) * share + black, 0, 255).round() for one in frames]).astype(np.uint8)
        arrays = {"frames": dusty, "empty": (empty - black) * share + black}
        yield Spoiled(f"{count} specks of dust", arrays, "rests on the glass")
    for share in (0.001, 0.005):
        draw = np.random.default_rng(3).random(frames.shape, dtype=np.float32)
        salty = np.where(draw < share / 2, 0, np.where(draw > 1 - share / 2, 255, frames)).astype(np.uint8)
        yield Spoiled(f"salt and pepper, {share:.1%}", {"frames": salty}, "salt and pepper")


def specks(trial: SyntheticScene, count: int) -> Array:
    """Return the share (H, W) of light under specks of dust, at the same positions on the glass in both views."""
    (rows, columns), generator = trial.frame_shape, np.random.default_rng(5)
    matrix, half = np.array(trial.topography_to_contact), columns // 2
    share = np.ones((rows, columns), np.float32)
    for right, down, wide in generator.random((count, 3)):
        at, radius = np.array([right * half, down * rows]), _RADII[0] + wide * (_RADII[1] - _RADII[0])
        for view, (x, y) in (("topography", at), ("contact", matrix[:, :2] @ at + matrix[:, 2])):
            part = trial.views[view].crop(share[None])[0]
            top, left = max(int(y - 3 * radius), 0), max(int(x - 3 * radius), 0)
            near = part[top : int(y + 3 * radius) + 2, left : int(x + 3 * radius) + 2]
            if near.size:
                below, beside = np.mgrid[top : top + near.shape[0], left : left + near.shape[1]]
                near *= 1 - _DARK * np.exp(-((((beside - x) ** 2 + (below - y) ** 2) / radius**2) ** 2))
    return share


def _encoded(recording: Path, folder: Path) -> Scene:
    """Write the frames of a recording as H.264, and return its scene."""
    options = {"crf": "28", "preset": "veryfast", "threads": "1"}
    write_video(folder / "a.mkv", np.load(recording / "frames.npy", mmap_mode="r"), "libx264", "yuv420p", **options)
    scene = scene_beside(recording, folder)
    text = scene.path.read_text(encoding="utf-8").replace((recording / "frames.npy").as_posix(), "a.mkv")
    scene.path.write_text(text, encoding="utf-8")
    return load_scene(scene.path)


def judged(case: str, trial: SyntheticScene, result: xr.Dataset, right: xr.Dataset, cause: str) -> Case:
    """Judge positions and energy of a spoiled trial; `right` is the result without the fault."""
    position, deviation = result["position_px"].values, result["position_std_px"].values
    looks = np.unique(np.linspace(1, trial.n_frames - 1, _LOOKS).astype(int))
    true = np.stack([trial.truth.follow(position[0], 0, frame) for frame in looks])
    away = np.hypot(*np.moveaxis(position[looks] - true, -1, 0))
    accepted = result["status"].values[looks] == TrackStatus.TRACKED
    wrong = accepted & (away > WRONG_PX) & ~(away < DEVIATIONS * deviation[looks])
    share = float(wrong.sum() / max(accepted.sum(), 1))
    off = result["strain_energy"].values - right["strain_energy"].values
    scatter = np.hypot(result["strain_energy_std"].values, right["strain_energy_std"].values)
    unknown = float(np.isnan(off[trial.n_frames // 4 :]).mean())
    square = np.square(off / scatter)[trial.n_frames // 4 :]
    energy = float(np.sqrt(np.mean(square[np.isfinite(square)]))) if np.isfinite(square).any() else np.nan
    said = [one for one in warnings_of(result).splitlines() if cause in one]
    exact = share < MOST_WRONG and unknown == 0 and energy < 3
    number = f"{share:.2%} wrong, energy {energy:.1f} deviations off, NaN in {unknown:.0%}"
    stated = f"{np.mean(accepted):.0%} accepted; " + (said or ["nothing"])[0][:90]
    return Case(case, number, "0", stated, "warned" if said else "right" if exact else "wrong in silence")


def second_touch() -> Case:
    """Judge a finger that is lifted and touches again with other skin at another position."""
    press = replace(PRESS, semi_axes=(2.2, 1.9), finger=(3.0, 2.6), n_frames=60, frame_rate=60.0)
    others = replace(press, texture=RidgeTexture(centre=(2.0, 1.5)))
    with tempfile.TemporaryDirectory() as folder:
        parts = []
        for name, trial, shift in (("first", press, -_AWAY), ("second", others, _AWAY)):
            write_quietly(Path(folder) / name, trial)
            frames, empty, dark = (
                np.load(Path(folder) / name / f"{one}.npy").astype(np.float32) for one in ("frames", "empty", "dark")
            )
            light = empty - dark
            share = np.where(light > 2, (frames - dark) / np.maximum(light, 2), 1)
            for view in trial.views.values():
                view.crop(share)[:] = np.roll(view.crop(share), shift, 2)
            parts.append(share)
        nothing = 1 + np.random.default_rng(1).normal(0, 0.015, (8, *light.shape))
        lifted = np.concatenate([parts[0], parts[0][::-2], nothing, parts[1]])
        arrays = {"frames": np.clip(lifted * light + dark, 0, 255).round().astype(np.uint8)}
        (Path(folder) / "both").mkdir()
        scene = scene_beside(Path(folder) / "first", Path(folder) / "both", forces=False, stream=False, **arrays)
        result = process(scene, OUTPUTS)
    found, deviation = (1e3 * float(result[f"median_divergence{of}"].values[-1]) for of in ("", "_std"))
    true = 1e3 * others.truth.medians(59).divergence
    verdict = "right" if abs(found - true) < 2 * deviation else "wrong in silence"
    return Case("second touch at another place", f"{found:.1f}", f"{true:.1f}", f"{deviation:.1f}", verdict)
