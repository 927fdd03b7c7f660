"""Cases of settings and data that contradict each other: each mistake is made on the default press with default
settings.

The number is the peak gross area, force or energy, or the variable that the mistake changes. A result that agrees with
the truth needs no warning; any other result must name the cause.
"""

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from fingerflow import load_scene, process
from fingerflow.engines.engine import Array
from fingerflow.errors import FingerflowError
from fingerflow.synthetic import Press, Slide, write_recording
from tests.silent.case import Case, without_fault
from tests.small_trials import scene_beside, turned, warnings_of

LOST = 27  # frames


def _topography(change: Callable[[Array], Array]) -> Callable[[Array], dict[str, Array]]:
    """Return what replaces the frames of the press by frames whose topography view is changed."""

    def arrays(frames: Array) -> dict[str, Array]:
        changed = frames.copy()
        view = Press().views["topography"].crop(changed)
        view[:] = change(view.copy())
        return {"frames": changed}

    return arrays


class Mistake(NamedTuple):
    """A mistake: texts of the scene that are replaced, the variable that the mistake changes, and words of the warning.

    Attributes:
        arrays: arrays that replace the files, from the frames of the press.
        forces: factor on the forces in the file; None for a trial without forces.
    """

    case: str
    replaced: dict[str, str]
    variable: str
    cause: str
    arrays: Callable[[Array], dict[str, Array]] = lambda _: {}
    forces: float | None = 1.0


UNITS, SCALE, TRANSFORM = '# units = "N"  ', "mm_per_px = 0.0325", "topography_to_contact = ["
MISTAKES = (
    Mistake("first_frame 60, contact since 18", {"# first_frame = 0": "first_frame = 60"}, "median_divergence",
        "the recording begins in contact"),
    Mistake("first_frame 285, contact is steady", {"# first_frame = 0": "first_frame = 285"}, "median_divergence",
        "the frames that count: they begin in contact"),
    Mistake("recording begins in contact, no forces", {"trigger_frame = 12": "trigger_frame = 0"}, "median_divergence",
        "the recording begins in contact", lambda frames: {"frames": frames[60:]}, forces=None),
    Mistake("transform inverted", {TRANSFORM: "inverse"}, "onset_frame", "calibration.topography_to_contact puts"),
    Mistake("transform left out", {TRANSFORM: "identity"}, "onset_frame", "calibration.topography_to_contact puts"),
    Mistake("background shows the finger", {}, "gross_contact_area", "background.frames is darker than frame 0",
        lambda frames: {"empty": frames[-1]}),
    Mistake("background shows a light touch", {}, "gross_contact_area", "background.frames is darker than frame 0",
        lambda frames: {"empty": frames[60]}),
    Mistake(f"{LOST} frames are missing", {}, "gross_contact_area", "frames may be missing there",
        lambda frames: {"frames": np.delete(frames, np.s_[100 : 100 + LOST], axis=0)}),
    Mistake(f"{LOST} frames are missing, no forces", {}, "gross_contact_area", "frames may be missing there",
        lambda frames: {"frames": np.delete(frames, np.s_[100 : 100 + LOST], axis=0)}, forces=None),
    Mistake(f"trigger {LOST} frames late", {"trigger_frame = 12": f"trigger_frame = {12 + LOST}"}, "normal_force",
        "Check recording.trigger_frame"),
    Mistake(f"trigger {LOST} frames early", {"trigger_frame = 12": "trigger_frame = 0",}, "normal_force",
        "Check recording.trigger_frame", lambda frames: {"frames": np.concatenate([frames[:1]] * 15 + [frames])}),
    Mistake("mN taken for N", {}, "normal_force", "is a mean pressure of", forces=1000.0),
    Mistake("g taken for N", {}, "normal_force", "is a mean pressure of", forces=101.97),
    Mistake("gain of 10 left out", {}, "normal_force", "is a mean pressure of", forces=10.0),
    Mistake("N taken for mN", {UNITS: 'units = "mN"'}, "normal_force", "is a mean pressure of"),
    Mistake("gain 2.5 of a force in N", {"[forces]": "[forces]\ngain = 2.5"}, "normal_force", "is in N already"),
    Mistake("columns of the forces exchanged", {'normal = "normal_force"': 'normal = "tangential_force"',
        'tangential = "tangential_force"': 'tangential = "normal_force"'}, "normal_force", "times the normal one"),
    Mistake("scale halved", {SCALE: "mm_per_px = 0.01625"}, "gross_contact_area", "the scale is wrong"),
    Mistake("scale doubled, a diameter taken for the radius", {SCALE: "mm_per_px = 0.065"}, "gross_contact_area",
        "the scale is wrong"),
    Mistake("Young's modulus 1000", {"young_modulus_mpa = 1.0": "young_modulus_mpa = 1000.0"}, "strain_energy",
        "fields.young_modulus_mpa = 1000"),
    Mistake("frame rate 2000 for 300", {"frame_rate = 300.0": "frame_rate = 2000.0"}, "median_divergence_rate",
        "Check recording.frame_rate"),
    Mistake("frame rate 66.7 for 300", {"frame_rate = 300.0": "frame_rate = 66.7"}, "median_divergence_rate",
        "recording.frame_rate"),
    Mistake("topography mirrored left to right", {}, "median_curl", "view is mirrored",
        _topography(lambda view: view[:, :, ::-1])),
    Mistake("topography mirrored top to bottom", {}, "median_curl", "view is mirrored",
        _topography(lambda view: view[:, ::-1])),
    Mistake("camera turns by 0.08 degrees RMS", {}, "median_curl", "the whole image vibrates",
        lambda frames: {"frames": turned(frames, 0.113)}),
    Mistake("camera turns by 0.3 degrees in 8 frames, and back", {}, "median_curl", "12 frames a period, most remains",
        lambda frames: {"frames": turned(frames, 0.3, 8)}),
    Mistake("topography frozen", {}, "median_curl", "repeats its picture",
        _topography(lambda view: view[:1].repeat(len(view), 0))),
    Mistake("topography saturated", {}, "median_curl", "topography view is saturated",
        _topography(lambda view: (view * 2.2).clip(0, 255).astype(view.dtype))),
)  # fmt: skip


def cases(few: bool = False) -> Iterator[Case]:
    """Yield the mistakes, or every other one, and recordings without one, which must give no new warning."""
    with tempfile.TemporaryDirectory() as folder:
        press = Path(folder) / "press"
        write_recording(press, Press())
        frames = np.load(press / "frames.npy", mmap_mode="r")
        right = process(press / "scene.toml")
        for mistake in MISTAKES[:: 2 if few else 1]:
            yield try_mistake(mistake, press, frames, right)
        yield without_fault("press", right)
        write_recording(Path(folder) / "slide", Slide())
        yield without_fault("slide", process(Path(folder) / "slide" / "scene.toml"))


def try_mistake(mistake: Mistake, press: Path, frames: Array, right: xr.Dataset) -> Case:
    """Make a mistake on a recorded press and judge the warnings of its result; `right` is the result without the
    mistake.
    """
    truth = _peak(right, mistake.variable)
    with tempfile.TemporaryDirectory() as folder:
        replaced = dict(mistake.replaced)
        if TRANSFORM in replaced:
            replaced = _transform(press, replaced[TRANSFORM])
        if mistake.forces not in (1.0, None):
            replaced |= _scaled(press / "forces.csv", Path(folder) / "forces.csv", mistake.forces)
        given = mistake.forces is not None
        scene = scene_beside(press, Path(folder), replaced, forces=given, **mistake.arrays(frames))
        try:
            result = process(scene)
        except FingerflowError as error:
            return Case(mistake.case, "none", truth, str(error).replace(f"{press}/", "")[:90], "refused")
        said = [one for one in warnings_of(result).replace(f"{press}/", "").splitlines() if mistake.cause in one]
        verdict = "warned" if said else "wrong in silence"
        return Case(mistake.case, _peak(result, mistake.variable), truth, (said or ["nothing"])[0][:90], verdict)


def _scaled(forces: Path, to: Path, factor: float) -> dict[str, str]:
    """Write the forces times a factor under the same heading; return the replacement of their file name
    in the scene.
    """
    heading, *lines = forces.read_text().splitlines()
    factors = [factor if "force" in name else 1.0 for name in heading.split(",")]
    values = np.loadtxt(lines, delimiter=",") * factors
    np.savetxt(to, values, fmt="%.6g", delimiter=",", header=heading, comments="")
    return {forces.as_posix(): to.as_posix()}


def _transform(press: Path, kind: str) -> dict[str, str]:
    line = next(one for one in (press / "scene.toml").read_text().splitlines() if one.startswith(TRANSFORM))
    matrix = load_scene(press / "scene.toml").calibration.topography_to_contact
    square = np.linalg.inv([*matrix, (0, 0, 1)]) if kind == "inverse" else np.eye(3)
    return {line: f"topography_to_contact = {square[:2].tolist()}"}


def _peak(result: xr.Dataset, variable: str) -> str:
    values = result[variable].values if variable in result else np.array([np.nan])
    if variable == "onset_frame":
        return f"{variable} {np.mean(values[values >= 0]):.1f}"
    return f"{variable} {np.nanmax(values):.4g}" if np.isfinite(values).any() else f"{variable} nan"
