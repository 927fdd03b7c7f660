"""Cases of objects and faults in the contact view beside the finger that make the areas of a small press wrong.

The number is the largest gross and real area, mm2, compared with the truth of the whole contact. A press and a slide
without a fault must give no warning.
"""

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
import xarray as xr

from bench.prints import DPI, FINGERS
from fingerflow import process
from fingerflow.engines.engine import Array
from fingerflow.errors import FingerflowError
from fingerflow.kernels.library import is_present
from fingerflow.synthetic import Press, Slide, scene_of_print, write_recording
from fingerflow.synthetic.scenes import SyntheticScene
from tests.silent.case import Case, played, without_fault
from tests.small_trials import scene_beside, warnings_of

Change = Callable[[Array, Press], Array]

PRESS = Press(
    n_frames=40,
    frame_rate=40.0,
    frames_before_trigger=3,
    frame_shape=(384, 960),
    semi_axes=(2.6, 2.2),
    finger=(4.0, 3.4),
)
AREAS = ["gross_contact_area", "real_contact_area", "gross_contact_area_std"]
AXES = "ellipse_semi_axes", "ellipse_semi_axes_std"
_RIGHT = 0.01, 0.015  # relative errors of gross and real area, beyond those without a fault, that need no warning


class Fault(NamedTuple):
    """A fault: its effect on the share of light in the contact views of frames (n, h, w) and of the background, and
    words of the warning.
    """

    case: str
    cause: str
    frames: Change
    background: Change | None = None
    moved_px: int = 0  # of the light, to the right


def _columns(pictures: Array) -> Array:
    return np.arange(pictures.shape[2], dtype=np.float64)


def _dark_third(pictures: Array, press: Press) -> Array:
    """Return pictures whose right part, into which the contact extends, is without light."""
    return pictures * np.where(_columns(pictures) > 0.58 * pictures.shape[2], 0.01, 1.0)


def _strip(width: int, angle: float, place: float = 0.45, kept: float = 0.3) -> Change:
    """Return a change that adds a dark strip, `width` px wide, at the fraction `place` of the view's width, rotated by
    `angle` rad.
    """

    def change(pictures: Array, press: Press) -> Array:
        y, x = np.mgrid[: pictures.shape[1], : pictures.shape[2]]
        away = (x - place * pictures.shape[2]) * np.cos(angle) + (y - 0.5 * pictures.shape[1]) * np.sin(angle)
        return pictures * np.where(np.abs(away) < width / 2, kept, 1.0)

    return change


def _halo(depth: float) -> Change:
    """Return a change that adds the shadow of a finger, which takes `depth` of the light at the contact and fades
    outside over about a millimetre.
    """

    def change(pictures: Array, press: Press) -> Array:
        y, x = np.mgrid[: pictures.shape[1], : pictures.shape[2]] * press.mm_per_px
        shadow = []
        for frame in range(len(pictures)):
            ellipse = press.truth.ellipse(frame)
            if ellipse is None:
                shadow.append(np.ones(pictures.shape[1:]))
                continue
            (right, down), (a, b) = ellipse.centre, ellipse.semi_axes
            outside = (np.hypot((x - right) / a, (y - down) / b) - 1) * np.sqrt(a * b)
            shadow.append(1 - depth * np.exp(-np.maximum(outside, 0) / 0.3))
        return pictures * np.stack(shadow)

    return change


def _faint(edge: float, width_mm: float, thinner_px: int = 999) -> Change:
    """Return a change that leaves ridges the share `edge` of their contrast at the border of the contact, which rises
    to all of it `width_mm` inside; the contrast beyond `thinner_px` from their edges remains.
    """

    def change(pictures: Array, press: Press) -> Array:
        y, x = (torch.from_numpy(line * press.mm_per_px) for line in np.mgrid[: pictures.shape[1], : pictures.shape[2]])
        result = pictures.copy()
        for frame, picture in enumerate(result):
            if (ellipse := press.truth.ellipse(frame)) is not None:
                inside = ellipse.distance(x, y).numpy()
                share = edge + (1 - edge) * np.clip(inside / width_mm, 0, 1)
                kept = cv2.dilate(picture, np.ones((thinner_px, thinner_px))) if thinner_px < 999 else 1.0
                picture[:] = np.where(inside > -0.05, kept - (kept - picture) * share, picture)
        return result

    return change


def _sweat(pictures: Array, press: Press) -> Array:
    """Return pictures in which sweat fills the valleys in patches 0.6 mm wide once skin touches there."""
    generator = np.random.default_rng(1)
    result, (right, down) = pictures.copy(), press.contact_centre
    y, x = np.mgrid[: pictures.shape[1], : pictures.shape[2]] * press.mm_per_px
    for radius, angle in zip(generator.uniform(0, 1.7, 12), generator.uniform(0, 2 * np.pi, 12), strict=True):
        patch = np.hypot(x - right - radius * np.cos(angle), y - down - radius * np.sin(angle)) < 0.3
        for frame in range(len(pictures)):
            progress = torch.tensor(press.truth.progress[frame])
            inside = patch & (press.depth(torch.from_numpy(x), torch.from_numpy(y), progress) > 0).numpy()
            result[frame][inside] = np.minimum(result[frame][inside], 0.52)
    return result


def _gradient(pictures: Array, press: Press) -> Array:
    return pictures * (1 - 0.15 * _columns(pictures) / pictures.shape[2])


def _zero_rows(pictures: Array, press: Press) -> Array:
    result = pictures.copy()
    result[:, 170:200] = 0
    return result


def _second(scale: float, right: int, down: int, first: int = 0) -> Change:
    """Return a change that adds a second contact from the frame `first` on: the first one in another size, moved by px
    to the right and down.
    """

    def change(pictures: Array, press: Press) -> Array:
        rows, columns = pictures.shape[1:]
        matrix = np.array([[scale, 0, columns / 2 * (1 - scale) + right], [0, scale, rows / 2 * (1 - scale) + down]])
        second = np.stack([cv2.warpAffine(one, matrix, (columns, rows), borderValue=1.0) for one in pictures])
        second[:first] = 1
        return np.where(second < 0.85, np.minimum(pictures, second), pictures)

    return change


def _exposed(factor: float) -> Change:
    return lambda pictures, press: factor * pictures


FAULTS = (
    Fault("right part of the glass dark", "without light", _dark_third, _dark_third),
    Fault("cable of 10 px across, since the first frame", "lies in the view", _strip(10, 0.3)),
    Fault("cable of 24 px across, since the first frame", "lies in the view", _strip(24, 0.3)),
    Fault("cable of 24 px beside the contact", "lies in the view", _strip(24, 0.3, 0.15)),
    Fault("halo of 35 %", "shadow", _halo(0.35)),
    Fault("rim faint over 0.4 mm", "faint at its rim", _faint(0.2, 0.4)),
    Fault("rim faint over 0.8 mm", "faint at its rim", _faint(0.4, 0.8)),
    Fault("ridges thinner by 5 px at the rim", "faint at its rim", _faint(0, 0.9, 11)),
    Fault("sweat in patches of 0.6 mm", "sweat", _sweat),
    Fault("30 rows of the background are zero", "lines of the background", _exposed(1), _zero_rows),
    Fault("camera bumped by 5 px", "has moved", _exposed(1), moved_px=5),
    Fault("light falls by 15 % across the view", "falls", _gradient),
    Fault("second contact of a third of the size", "second contact", _second(0.35, -165, 90)),
    Fault("second contact of a thirtieth of the area", "second contact", _second(0.18, -165, 90)),
    Fault("second contact that merges with the first", "second contact", _second(0.4, -125, 0)),
    Fault("second contact that touches the first, later", "second contact", _second(0.5, -125, 0, 30)),
    Fault("second finger of the same size", "second contact", _second(1, 178, 0)),
    Fault("contact view saturated", "saturated", _exposed(2), _exposed(2)),
    Fault("empty glass at 0.3 of the exposure", "another exposure", _exposed(1), _exposed(0.3)),
    Fault("empty glass at four times the exposure", "another exposure", _exposed(1), _exposed(4)),
)


def cases(few: bool = False) -> Iterator[Case]:
    """Yield the faults and small contacts; unless `few` those of real prints too, and recordings without a fault."""
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "press"
        write_recording(recording, PRESS)
        right = process(recording / "scene.toml", AREAS)
        for fault in FAULTS:
            yield try_fault(fault, recording, right)
            if "rim" in fault.cause and is_present():
                yield try_fault(fault, recording, right, live=True)
        yield without_fault("small press", right)
    yield from _small_contacts(few)
    for scene in () if few else (Press(n_frames=60, frame_rate=60.0, frames_before_trigger=3), Slide()):
        with tempfile.TemporaryDirectory() as folder:
            write_recording(Path(folder) / "trial", scene)
            yield without_fault(type(scene).__name__, process(Path(folder) / "trial" / "scene.toml", AREAS))


def _small_contacts(few: bool) -> Iterator[Case]:
    """Yield presses with a contact area below 1 mm²."""
    skins: dict[str, SyntheticScene] = {"rings": PRESS}
    if FINGERS.is_dir() and not few:
        skins |= {f"print {name}": scene_of_print(Press, FINGERS / f"{name}.tif", DPI) for name in ("101_1", "104_1")}
    for name, skin in skins.items():
        for semi_axes in ((0.2, 0.15), (0.45, 0.4), (0.6, 0.5))[not is_present() :]:
            press, live = replace(PRESS, texture=skin.texture, semi_axes=semi_axes), semi_axes[0] < 0.3
            with tempfile.TemporaryDirectory() as folder:
                write_recording(Path(folder) / "press", press)
                scene = Path(folder) / "press" / "scene.toml"  # `process` refuses the smallest
                result = played(scene) if live else process(scene, [*AREAS, *AXES])
            progress = press.progress(press.times)
            axes = np.outer(progress, semi_axes)[progress > 0]
            sizes = {"gross_contact_area": np.pi * axes.prod(1), "ellipse_semi_axes": axes}
            for size in [*sizes][: 2 - live]:
                found, deviation = (result[f"{size}{of}"].values[progress > 0] for of in ("", "_std"))
                z = np.abs(found - sizes[size]) / deviation
                worst, spread = np.nanmax(z), np.sqrt(np.nanmean(z**2))
                largest = f"{np.nanmax(z * deviation):.2f} off, {spread:.1f} std RMS, {worst:.1f} worst"
                verdict = "right" if spread < 2 and worst < 4 else "wrong in silence"
                stated = f"{np.nanmin(deviation):.2f} to {np.nanmax(deviation):.2f}"
                name_of = f"{'live: ' * live}{sizes['gross_contact_area'][-1]:.2f} mm2 of {name}, {size}"
                yield Case(name_of, largest, "0", stated, verdict)


def try_fault(fault: Fault, recording: Path, right: xr.Dataset, live: bool = False) -> Case:
    """Apply a fault to a recorded press and judge the warnings and areas of its result, or of a stream if `live`;
    `right` is the result without the fault.
    """
    view = PRESS.views["contact"]
    frames, empty, dark = (
        np.load(recording / f"{name}.npy").astype(np.float64) for name in ("frames", "empty", "dark")
    )
    glass, black = (view.crop(one[None]) for one in (empty, dark))
    light = glass - black
    share = np.where(light > 2, (view.crop(frames) - black) / np.maximum(light, 2), 1.0)
    kept = fault.frames(share, PRESS)
    view.crop(frames)[:] = np.clip(kept * np.roll(light, fault.moved_px, 2) + black, 0, 255).round()
    if fault.background is not None:
        view.crop(empty[None])[:] = fault.background(light, PRESS) + black * (fault.background is not _zero_rows)
    with tempfile.TemporaryDirectory() as folder:
        arrays = {"frames": frames.astype(np.uint8), "empty": empty.astype(np.float32)}
        scene = scene_beside(recording, Path(folder), **arrays)
        truth = f"{PRESS.truth.gross_contact_area_mm2(39):.2f}, {PRESS.truth.real_contact_area_mm2(39):.2f}"
        try:
            result = played(Path(folder) / "scene.toml") if live else process(scene, AREAS)
        except FingerflowError as error:
            said = str(error).replace(f"{folder}/", "")
            return Case(
                fault.case, "none", truth, said, "refused" if fault.cause in said else "refused without the cause"
            )
        said = [one for one in warnings_of(result).replace(f"{folder}/", "").splitlines() if fault.cause in one]
        errors = [
            np.nanmax(np.abs(result[name].values - right[name].values)) / right[name].values.max() for name in AREAS[:2]
        ]
        correct = all(error < most for error, most in zip(errors, _RIGHT, strict=True))
        verdict = "warned" if said else "right" if correct else "wrong in silence"
        found = f"{np.nanmax(result['gross_contact_area']):.2f}, {np.nanmax(result['real_contact_area']):.2f}"
        return Case("live: " * live + fault.case, found, truth, (said or ["nothing"])[0], verdict)
