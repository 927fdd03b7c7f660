"""Tests of unusable frames of a recorded press; `test_bad_frames` of the player has each kind, live and recorded."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import xarray as xr

from fingerflow import process
from fingerflow.engines.engine import Array
from fingerflow.errors import FingerflowError
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.recordings.frames.recording import Recording
from fingerflow.schema.scene import Scene
from fingerflow.schema.variables import FRAME_STATUS
from tests.silent.case import played
from tests.small_trials import SPOILED, scene_beside, warnings_of

FAR = "jumps_and_returns"
AREAS = ("real_contact_area", "gross_contact_area", "contact_threshold")


class Clean(NamedTuple):
    scene: Scene
    frames: Array
    result: xr.Dataset


@pytest.fixture(scope="module")
def clean(trials: Path, tmp_path_factory: pytest.TempPathFactory) -> Clean:
    folder = tmp_path_factory.mktemp("clean")
    scene = scene_beside(trials / "press", folder, {"threshold = 0.27": 'threshold = "reference_frame"'})
    return Clean(scene, np.load(scene.recording.frames), process(scene))


def with_frames(clean: Clean, frames: Array, folder: Path) -> Scene:
    np.save(folder / "frames.npy", frames)
    return replace(clean.scene, recording=replace(clean.scene.recording, frames=folder / "frames.npy"))


def status_of(result: xr.Dataset) -> dict[int, str]:
    values = result["frame_status"].values
    return {int(k): FRAME_STATUS[values[k]] for k in np.flatnonzero(values)}


def test_a_bad_first_and_last_frame(clean: Clean, tmp_path: Path) -> None:
    """Points are seeded in the first usable frame, and areas do not change; also without forces."""
    frames, last = clean.frames.copy(), len(clean.frames) - 1
    for k, kind in ((0, "dim contact view"), (last, "rolled")):
        frames[k] = SPOILED[kind][0](frames[k])
    scene = with_frames(clean, frames, tmp_path)
    for forces, expected in ((scene.forces, clean.result), (None, process(replace(clean.scene, forces=None), AREAS))):
        result = process(replace(scene, forces=forces), [*AREAS, "status"])
        assert status_of(result) == {0: FAR, last: FAR}
        assert f": 0, {last}. No result counts them" in warnings_of(result)
        assert (result["status"].values[1] == TrackStatus.TRACKED).all()
        for name in AREAS:
            np.testing.assert_allclose(result[name].values[1:-1], expected[name].values[1:-1], rtol=5e-3, err_msg=name)


def test_skin_that_rushes_as_it_lands_leaves_frames_of_empty_glass(clean: Clean, tmp_path: Path) -> None:
    frames = clean.frames.copy()
    frames[:3, :, :240] = np.roll(frames[:3, :, :240], 15, axis=2)
    assert status_of(process(with_frames(clean, frames, tmp_path), ["frame_status"])) == {}


def test_a_camera_that_gives_every_frame_twice_is_named(clean: Clean, tmp_path: Path) -> None:
    half = np.repeat(clean.frames[::2], 2, axis=0)
    result = process(with_frames(clean, half, tmp_path), ["frame_status"])
    assert status_of(result) == {}
    assert "50% of the frames repeat another one" in warnings_of(result)


@pytest.mark.parametrize(("view", "columns"), [("topography", slice(240)), ("contact", slice(240, 480))])
def test_a_frozen_view_counts_in_no_number(view: str, columns: slice, trials: Path, tmp_path: Path) -> None:
    """A view that stands still from frame 20 on is named, live and recorded, and counts no more from the fourth on.

    So do frames in which it stands still while the other view is dark.
    """
    frames, dark = np.load(trials / "press" / "frames.npy"), range(30, 40) if view == "topography" else range(0)
    frames[21:, :, columns] = frames[20, :, columns]
    frames[dark, :, 240:] //= 16
    scene = scene_beside(trials / "press", tmp_path, frames=frames)
    for result in (process(scene, AREAS), played(scene.path)):
        assert status_of(result) == dict.fromkeys(range(24, 72), "repeated") | dict.fromkeys(dark, "dark")
        assert f"the {view} view repeats its picture while the other view goes on, in 51 frames" in warnings_of(result)
    frames[:, :, columns] = frames[20, :, columns]
    frames[slice(0, len(dark)), :, 240:] //= 16
    (tmp_path / "always").mkdir()
    scene = scene_beside(trials / "press", tmp_path / "always", frames=frames)
    with pytest.raises(FingerflowError, match=f"no frame can be measured: the {view} view repeats its picture"):
        process(scene, AREAS)
    assert f"the {view} view repeats its picture while the other view goes on, in 71" in warnings_of(played(scene.path))


def test_nothing_but_bad_frames_is_no_recording(clean: Clean, tmp_path: Path) -> None:
    message = rf"frames\.npy: no frame can be measured: {len(clean.frames)} dark frames\. Check"
    with pytest.raises(FingerflowError, match=message):
        process(with_frames(clean, np.full_like(clean.frames, 8), tmp_path), ["real_contact_area"])


def test_errors_that_the_decoder_got_over_are_told(clean: Clean, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Recording, "doubtful", {3: "error while decoding MB 3 0", 40: "no frame!"})
    said = warnings_of(process(clean.scene, ["frame_status"]))
    assert "the decoder reported errors at 3, 40 (error while decoding MB 3 0); their pixels may be wrong" in said
