"""Tests of user errors, which are reported with value and remedy, and of missing data, which the result states."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from fingerflow import process
from fingerflow.engines.engine import Array
from fingerflow.errors import FingerflowError
from fingerflow.recordings.frames.recording import Recording
from fingerflow.results.result import load_result, save_result
from fingerflow.results.tables import export_table
from fingerflow.synthetic import rebuild_scene
from tests.pipeline.stages.conftest import Change
from tests.small_trials import warnings_of

AREAS = ["real_contact_area", "gross_contact_area", "contact_threshold", "ellipse_center"]
FIXED = {'threshold = "reference_frame"': "threshold = 0.25"}
PER_FRAME = {'threshold = "reference_frame"': 'threshold = "per_frame"'}


@pytest.fixture(scope="module")
def glass(press: Path) -> Array:
    """Return eight frames (8, H, W) of the empty glass, each with its own noise."""
    scene = rebuild_scene(press)
    return np.stack([scene.empty(number) for number in range(8)])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("columns = [0, 120]", "columns = [200, 320]", r"scene\.toml: views\.topography .*\[200, 320\]"),
        ("rows = [0, 96]  ", "rows = [0, 8]  ", "its shorter side is 8 px, and a view needs 9; give more"),
        ("gross_radius_px = 8", "gross_radius_px = 99", "a third of the contact view's shorter side fits, 32 px"),
        ("trigger_frame = 1 ", "trigger_frame = 8", r"trigger_frame is 8, but .*frames\.npy has 8 frames, 0 to 7"),
        ("# first_frame = 0", "first_frame = 8", r"first_frame is 8, but .*frames\.npy has 8 frames, 0 to 7"),
        ('trigger = "trigger"', 'trigger = "start"', "forces.csv: has no column 'start'; its columns are .*'trigger'"),
        (
            'tangential = "tangential_force"',
            "tangential = 2",
            "one column is named twice in .*'tangential_force': 'nor",
        ),
        ('/forces.csv"', '/../../../../../../../dev/zero"', "/dev/zero: is a device, not a file"),
    ],
)
def test_a_setting_that_does_not_fit_the_files_is_named(changed: Change, old: str, new: str, message: str) -> None:
    with pytest.raises(FingerflowError, match=message):
        process(changed({old: new}), ["gross_contact_area"])


def test_frames_that_cannot_be_processed_are_named(
    changed: Change, frames: Array, glass: Array, press: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    message = r"no contact at the largest force \(frame 7\): .* frame rate and trigger, .*\[views\.contact\].*a number"
    with pytest.raises(FingerflowError, match=message):
        process(changed(frames=glass), AREAS)
    for device in "gpu", "":
        with pytest.raises(FingerflowError, match=f"device '{device}' cannot be used.*choose auto, cpu or cuda"):
            process(changed(), AREAS, device=device)
    empty = np.load(press / "empty.npy").round().astype(np.uint8)
    with pytest.raises(FingerflowError, match=r"empty\.npy: the background has 8 bit, .*frames\.npy 16.*same camera"):
        process(changed(frames=frames.astype(np.uint16) * 16, empty=empty), AREAS)
    monkeypatch.setattr(Recording, "__len__", lambda _: 0)  # like a video without frames
    with pytest.raises(FingerflowError, match=r"frames\.npy has no frame"):
        process(changed(), AREAS)


def test_one_frame_has_areas_and_no_rates(changed: Change, frames: Array) -> None:
    result = process(changed({"trigger_frame = 1 ": ""}, frames=frames[5:6], forces=False))
    assert result["gross_contact_area"].values[0] == pytest.approx(3.45, rel=0.05)
    touched = result["onset_frame"].values == 0
    assert touched.any()
    assert (result["displacement"].values[0, touched] == 0).all()
    for name in ("median_divergence_rate", "median_strain_rate", "strain_energy_rate"):
        assert np.isnan(result[name].values).all(), name
    assert "one frame: nothing has moved" in warnings_of(result)
    slow = process(changed({"rate_window_s = 0.05": "rate_window_s = 9.0 "}), ["median_divergence_rate"])
    assert "rate_window_s = 9 lasts longer than the medians are known" in warnings_of(slow)


def test_an_empty_glass_has_no_area_and_no_point(changed: Change, glass: Array, tmp_path: Path) -> None:
    result = process(changed(PER_FRAME, frames=glass))
    for name in ("real_contact_area", "gross_contact_area"):
        assert not result[name].any()
    assert result.sizes["point"] == result.sizes["triangle"] == 0
    for name in ("ellipse_center", "ellipse_angle", "median_divergence", "global_displacement", "tracked_share"):
        assert np.isnan(result[name].values).all(), name
    assert "no contact at the largest force (frame 7): there are no points" in warnings_of(result)
    process(changed(PER_FRAME, frames=glass), "printed_strain")
    save_result(result, tmp_path / "result.h5")
    assert not load_result(tmp_path / "result.h5").sizes["point"]
    for name in ("table.csv", "all.mat"):
        export_table(result, tmp_path / name)


def test_a_frame_that_is_no_picture_is_left_out(changed: Change, frames: Array) -> None:
    """A frame with infinite pixels, or with a patch of NaN in either view, has NaN results and leaves the areas of all
    other frames unchanged.
    """
    damaged = frames.astype(np.float32)
    expected = process(changed(frames=damaged), AREAS)
    damaged[4] = np.inf
    damaged[5, 40:50, 175:185] = np.nan  # contact view
    damaged[6, 40:50, 40:50] = np.nan  # topography view
    result = process(changed(frames=damaged))
    bad = [4, 5, 6]
    for name in AREAS:
        assert np.isnan(result[name].values[bad]).all(), name
        np.testing.assert_array_equal(np.delete(result[name], bad, 0), np.delete(expected[name].values, bad, 0))
    assert (result["status"].values[bad] != 0).all()
    assert (result["status"].values[7] == 0).mean() > 0.9
    for name in ("position", "median_divergence"):
        assert np.isnan(result[name].values[bad]).all()
    assert "frames with pixels that are NaN or infinite: 4, 5, 6. No result counts them" in warnings_of(result)


def test_a_damaged_frame_of_the_background_does_not_count(changed: Change, press: Path, tmp_path: Path) -> None:
    empty = np.load(press / "empty.npy")
    with h5py.File(tmp_path / "empty.h5", "w") as file:
        stack = file.create_dataset("x", (3, *empty.shape), "f4", chunks=(1, *empty.shape))
        stack[0] = stack[2] = empty
    damaged = process(changed({(press / "empty.npy").as_posix(): "empty.h5", **FIXED}), ["real_contact_area"])
    whole = process(changed(FIXED), ["real_contact_area"])
    np.testing.assert_allclose(damaged["real_contact_area"], whole["real_contact_area"])
    assert damaged["real_contact_area"].max() > 1


def test_files_are_let_go_of(changed: Change, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each recording and its background are closed after processing, so that one process can handle thousands."""
    closed, close = set[str](), Recording.close

    def noted(recording: Recording) -> None:
        closed.add(recording.path.name)
        close(recording)

    monkeypatch.setattr(Recording, "close", noted)
    process(changed(), AREAS)
    assert closed == {"frames.npy", "empty.npy", "dark.npy"}
