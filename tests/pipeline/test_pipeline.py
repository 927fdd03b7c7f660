"""Tests of the pipeline on a short synthetic press: the stages that run for an output, and the reference of its
numbers.

tests/test_press_accuracy.py compares the numbers with truth.
"""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from fingerflow import load_scene, process
from fingerflow.errors import FingerflowError
from fingerflow.pipeline import run
from fingerflow.pipeline.plan import OUTPUTS, VARIABLES
from fingerflow.pipeline.stages.tracking.tracking_stage import TrackingStage
from fingerflow.recordings import Recording
from fingerflow.recordings.frames.recording import FrameFile
from fingerflow.results.result import load_result, save_result
from fingerflow.schema.scene import Scene, Views
from fingerflow.schema.variables import SLIP, by_name
from fingerflow.synthetic import Camera, rebuild_scene
from tests.small_trials import SMALL_PRESS, write_small


@pytest.fixture(scope="module")
def press(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a press of 24 frames in small views, and return its folder."""
    trial = replace(SMALL_PRESS, n_frames=24, frame_rate=24.0, frames_before_trigger=2)
    return write_small(tmp_path_factory.mktemp("press") / "press", trial).parent


@pytest.fixture(scope="module")
def scene(press: Path) -> Scene:
    return load_scene(press / "scene.toml")


@pytest.fixture(scope="module")
def result(scene: Scene) -> xr.Dataset:
    return process(scene)


def test_the_printed_displacement_is_the_median_over_the_points(scene: Scene, result: xr.Dataset) -> None:
    """Of each component; the lab's script takes the x median twice."""
    printed = process(scene, ["printed_global_displacement"])["printed_global_displacement"].values
    expected = np.nanmedian(result["displacement"].values[-1], axis=0)
    np.testing.assert_allclose(printed[-1], np.hypot(*expected))


def test_before_contact_nothing_is_made_up(result: xr.Dataset) -> None:
    assert result["real_contact_area"].values[0] == 0
    assert result["gross_contact_area"].values[0] == 0
    assert (result["gross_contact_area_std"].values[0], result["real_contact_area_std"].values[0]) == (0.04, 0.01)
    for name in ("ellipse_angle", "median_divergence", "global_displacement"):
        assert np.isnan(result[name].values[0]), name
    assert np.isnan(result["displacement"].values[:, result["onset_frame"].values < 0]).all()


def test_what_a_wide_median_takes_is_within_the_deviation(scene: Scene, result: xr.Dataset) -> None:
    wide = process(replace(scene, contact=replace(scene.contact, median_px=9)), ["real_contact_area_std"])
    taken = float((result["real_contact_area"] - wide["real_contact_area"])[-1])
    assert 0.2 < taken < 3 * float(wide["real_contact_area_std"][-1])


def test_noise_is_within_the_deviations(tmp_path: Path) -> None:
    """Noise counts as contact, and with template "previous" more energy is subtracted for it than it has added."""
    scene = load_scene(write_small(tmp_path / "press", replace(SMALL_PRESS, camera=Camera(noise=8))))
    noisy, previous = process(scene), process(replace(scene, tracking=replace(scene.tracking, template="previous")))
    assert 0.1 < noisy["real_contact_area"][0] < noisy["real_contact_area_std"][0]
    energy = "strain_energy_between_points"
    assert (abs(previous[energy] - noisy[energy]) < previous[f"{energy}_std"])[-6:].all()


def test_the_rigid_residual_of_too_little_is_unknown(scene: Scene, result: xr.Dataset) -> None:
    """Where coverage is below 0.85; and everywhere with three points, of which a rigid motion leaves nothing."""
    residual = result["rigid_residual_median"].values
    assert (np.isfinite(residual) == (result["field_coverage"].values >= 0.85)).all()
    few = process(replace(scene, tracking=replace(scene.tracking, points=3)), ["rigid_residual_median"])
    assert np.isnan(few["rigid_residual_median"]).all()


def test_displacement_counts_from_the_way_to_the_onset(result: xr.Dataset) -> None:
    """At onset, displacement is a fraction of the step from the previous frame, 1/2 on average."""
    onset, position = result["onset_frame"].values, result["position"].values
    touched = np.flatnonzero((onset > 0) & np.isfinite(position[onset - 1, np.arange(len(onset))]).all(-1))
    assert len(touched) > 100
    moved = result["displacement"].values[onset[touched], touched]
    step = position[onset[touched], touched] - position[onset[touched] - 1, touched]
    share = (moved * step).sum(-1) / (step**2).sum(-1)
    np.testing.assert_allclose(moved, share[:, None] * step, atol=1e-9)
    assert ((share > -1e-9) & (share < 1 + 1e-9)).all()
    assert 0.3 < share.mean() < 0.7


def test_every_variable_says_its_unit(result: xr.Dataset) -> None:
    for name, values in result.data_vars.items():
        assert values.attrs["units"], name
        assert values.attrs["long_name"], name
    others = {*by_name(SLIP), "actuator_position"}  # outputs of other kinds of scene, and of a channel that is not here
    assert {name for name in OUTPUTS if VARIABLES[name].unasked} - others <= set(map(str, result.data_vars))
    assert json.loads(result.attrs["settings"])["tracking"]["window_px"] == 15


def test_backward_and_previous_track_too(scene: Scene, press: Path) -> None:
    truth = rebuild_scene(press).truth
    settings = replace(scene.tracking, direction="backward", template="previous")
    pixels = process(replace(scene, tracking=settings), ["position_px", "status"])["position_px"].values
    material = truth.material(truth.topography_positions(pixels[-1]), len(pixels) - 1)
    found = np.isfinite(pixels[0]).all(-1)
    error = (pixels[0] - truth.topography_pixels(truth.positions(material, 0)))[found]
    # Errors add up from frame to frame over 23 large steps, whose deformation is not modelled.
    assert found.mean() > 0.8
    assert np.median(np.linalg.norm(error, axis=1)) < 0.3


def test_area_alone_tracks_nothing(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(TrackingStage, "begin", None)
    areas = process(scene, ["real_contact_area"])
    assert "position" not in areas
    assert np.isfinite(areas["real_contact_area"]).all()


def test_what_cannot_be_computed_is_named(scene: Scene, tmp_path: Path) -> None:
    alone = Views({"contact": scene.views.contact})
    itself = replace(scene.background, frames=scene.recording.frames, dark=None)
    later = replace(scene.recording, first_frame=3)
    cases: list[tuple[dict[str, Any], str, str]] = [
        ({"background": itself}, "real_contact_area", "the recording itself"),
        ({"background": itself, "recording": later}, "real_contact_area", "the recording itself"),
        ({"background": replace(scene.background, dark=scene.background.frames)}, "gross_contact_area", "as bright as"),
        ({}, "real_contact_aera", "did you mean 'real_contact_area'"),
        ({"views": alone}, "divergence", "topography"),
        ({"forces": None}, "normal_force", "forces"),
    ]
    for changes, output, message in cases:
        with pytest.raises(FingerflowError, match=message):
            process(replace(scene, **changes), output)
    for path in ("", ".", "/"):
        with pytest.raises(FingerflowError, match="cannot be written; name a file"):
            process(scene, "normal_force", to=path)
    calibration = tmp_path / "calibration.toml"
    calibration.write_bytes(b"mine")
    with pytest.raises(FingerflowError, match="would be replaced"):
        process(
            replace(scene, calibration=replace(scene.calibration, file=calibration)), "normal_force", to=calibration
        )
    with pytest.raises(FingerflowError, match="no_such"):
        process(tmp_path / "no_such.toml")


def test_forces_alone_decode_no_frame(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FrameFile, "read", None)
    monkeypatch.setattr(Recording, "mapped", None)
    forces = process(scene, ["normal_force"])
    made = {"load_ratio", "force_angle", "tangential_direction"}
    assert set(forces.data_vars) == {"normal_force", "tangential_force"} | made


def test_frames_are_selected_by_time(result: xr.Dataset, tmp_path: Path) -> None:
    """Frames are selected by time in memory, from a file and after a selection of frames, and keep their numbers."""
    save_result(result, tmp_path / "result.h5")
    times = result["time"].values
    for given in (result, load_result(tmp_path / "result.h5"), result.isel(frame=slice(2, None))):
        near = given.sel(time=times[5] + 0.2 * (times[6] - times[5]), method="nearest")
        assert int(near["frame"]) == int(result["frame"][5])
        assert given.sel(time=slice(times[4], times[6])).sizes["frame"] == 3
        assert float(given.sel(frame=int(result["frame"][4]))["time"]) == times[4]


def test_threads_change_no_number(scene: Scene, torch_threads: Callable[[int], None]) -> None:
    """Results do not depend on the number of threads; with two, batches are read ahead and work is divided."""
    results = []
    for threads in (1, 2):
        torch_threads(threads)
        results.append(process(scene, ["position_px", "gross_contact_area", "median_divergence"]))
    for name in results[0].data_vars:
        np.testing.assert_array_equal(results[1][name].values, results[0][name].values, err_msg=str(name))


def test_a_scene_with_a_single_view(press: Path, scene: Scene, tmp_path: Path) -> None:
    """A scene with a single view gives the same results as two equal views related by the identity."""
    text = (press / "scene.toml").read_text(encoding="utf-8")
    for name in ("frames.npy", "empty.npy", "dark.npy", "forces.csv"):
        text = text.replace(f'"{name}"', f'"{(press / name).as_posix()}"')
    text = re.sub(r"topography_to_contact = .*\n", "", text)
    single = re.sub(r"\[views.topography\].*\n.*\n.*\n", "", text.replace("[views.contact]", "[views.camera]"))
    (tmp_path / "single.toml").write_text('kind = "single_view"\n' + single, encoding="utf-8")
    both = scene.views.contact
    two = replace(
        load_scene(tmp_path / "single.toml"), kind="press", views=Views({"contact": both, "topography": both})
    )
    found, expected = process(tmp_path / "single.toml"), process(two)
    assert found.sizes["point"] > 100
    for name in expected.data_vars:
        np.testing.assert_array_equal(found[name].values, expected[name].values, err_msg=str(name))


def test_points_may_be_chosen_in_the_picture_that_the_paper_enhances(scene: Scene, press: Path) -> None:
    """Points seeded in the enhanced image differ and are tracked to 1.2 of the error: sharpening raises noise, but
    tracking uses the recorded image.
    """
    tracking = replace(scene.tracking, points_from="enhanced")
    plain, enhanced = (process(one, ["position_px"]) for one in (scene, replace(scene, tracking=tracking)))
    truth = rebuild_scene(press).truth
    errors = []
    for result in (plain, enhanced):
        pixels = result["position_px"].values
        material = truth.material(truth.topography_positions(pixels[0]), 0)
        last = truth.topography_pixels(truth.positions(material, len(pixels) - 1))
        errors.append(np.nanmedian(np.linalg.norm(pixels[-1] - last, axis=-1)))
    assert not np.array_equal(plain["position_px"].values[0], enhanced["position_px"].values[0])
    assert errors[1] < 1.2 * errors[0]


def test_frames_that_cannot_be_read_are_not_blamed_on_the_result(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(Recording, "mapped", fail)
    for to in (None, tmp_path / "result.h5"):
        with pytest.raises(FingerflowError, match=r"npy: frames cannot be read \(Input/output error\)"):
            process(replace(scene, contact=replace(scene.contact, threshold=0.3)), ["real_contact_area"], to=to)
    assert not list(tmp_path.iterdir())


def test_results_do_not_depend_on_batches(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stated deviations of batches of five frames are those of all frames at once, but for rounding."""
    names = ["divergence_std", "curl_std", "median_strain_std", "strain_energy_std"]
    whole = process(scene, names)
    monkeypatch.setattr(run, "_NUMBERS", 5)
    parts = process(scene, names)
    for name in names:
        np.testing.assert_allclose(parts[name].values, whole[name].values, rtol=1e-4, err_msg=name)
