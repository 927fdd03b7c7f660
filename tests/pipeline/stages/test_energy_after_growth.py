"""Tests of the strain energy of presses whose contact stops growing, is dragged, or shrinks while its skin moves."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.contact_grid import energy_since_onset
from bench.prints import DPI, FINGERS
from bench.recordings import write_quietly
from bench.suites.stated import strained
from fingerflow import process
from fingerflow.synthetic import scene_of_print
from tests.pipeline.stages.courses import CourseOfPress
from tests.small_trials import edit_scene

_SHAPE: dict[str, Any] = {"frame_shape": (418, 1044), "finger": (6.2, 5.2), "semi_axes": (4.4, 3.6)}
_PRESS = CourseOfPress(**_SHAPE, n_frames=60, frame_rate=60.0, frames_before_trigger=3)
_SLOW = replace(_PRESS, n_frames=30, frame_rate=30.0, frames_before_trigger=1)
_DRAGGED = replace(_PRESS, grown=0.5, held=0.9, dragged=(0.3, 0.1))
#: Course, print, and number of points.
COURSES = {
    "saturates early, 30 frames/s": (replace(_SLOW, grown=0.6, held=0.85), "101_1", 700),
    "saturates, few points": (replace(strained(_PRESS, 1.5), grown=0.8, held=0.95), "101_2", 300),
    "is dragged far": (_DRAGGED, "101_4", 700),
    "is dragged, 15 frames/s": (replace(_DRAGGED, n_frames=15, frame_rate=15.0, frames_before_trigger=1), "101_4", 700),
    "is released": (replace(_PRESS, grown=0.5, held=0.65, lifts=0.7, released=0.8), "104_2", 700),
}


def z_of_energies(press: CourseOfPress, folder: Path, points: int, every: int) -> np.ndarray:
    """Return the errors of both strain energies (n, 2), in deviations, of some frames with more than 10 mm2."""
    write_quietly(folder / "recording", press)
    result = process(edit_scene(folder / "recording", {"points = 700": f"points = {points}"}))
    frames = [k for k in range(0, press.n_frames, every) if press.truth.gross_contact_area_mm2(k) > 10]
    true = np.array([energy_since_onset(press, result, k, 0.1) for k in frames])
    names = "strain_energy", "strain_energy_between_points"
    found, stated = (np.stack([result[n + end].values[frames] for n in names], 1) for end in ("", "_std"))
    assert np.isfinite(found).all()
    return (found - true) / stated


def test_energy_once_the_contact_stops_growing(tmp_path: Path) -> None:
    """Contact grows for 0.5 s, and the skin moves on for another 0.2 s: a field that vanishes at the border would be 29
    deviations off.
    """
    press = replace(strained(_SLOW, 2.0), grown=0.7, held=0.95)
    assert abs(z_of_energies(press, tmp_path, 700, 6)).max() < 3


@pytest.mark.long
@pytest.mark.parametrize("name", COURSES)
def test_energy_of_real_prints(name: str, tmp_path: Path) -> None:
    """Both energies are within 3.3 of their deviations in fifteen frames, and three in five within 1.25."""
    if not FINGERS.is_dir():
        pytest.skip(f"the real prints are not here: {FINGERS} does not exist")
    press, fingerprint, points = COURSES[name]
    texture = scene_of_print(CourseOfPress, FINGERS / f"{fingerprint}.tif", DPI).texture
    z = abs(z_of_energies(replace(press, texture=texture), tmp_path, points, press.n_frames // 15))
    assert z.max() < 3.3
    assert np.mean(z < 1.25) > 0.6
