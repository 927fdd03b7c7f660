"""Tests of a soft sensor against exact truth: identities, displacement and slip from a compressed colour video."""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray
from typer.testing import CliRunner

from bench.suites.tactile import dark_spots
from fingerflow import load_scene, process
from fingerflow.cli import app
from fingerflow.errors import FingerflowError
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.pipeline.stages.soft_sensor.rest import find_rest
from fingerflow.report import write_report
from fingerflow.schema.scene_file import SceneError, read_scene
from fingerflow.schema.scene_template import gel_scene_text
from tests.small_trials import GEL, GEL_MM_PER_PX

TACTILE = Path(__file__).resolve().parents[4] / "shared" / "data" / "tactile"


@pytest.fixture(scope="module")
def result(gel_recording: Path) -> xr.Dataset:
    return process(gel_recording)


@pytest.fixture(scope="module")
def truth(result: xr.Dataset) -> NDArray[np.float64]:
    """Return the true positions (frames, N, 2) px of the marker that each point is in the frame at rest."""
    rest = result["position_px"].values[0]
    known = np.isfinite(rest).all(-1)
    apart = np.linalg.norm(rest[:, None] - GEL.markers[None], axis=-1)
    marker = np.where(known, np.nanargmin(np.where(known[:, None], apart, 0), axis=1), 0)
    assert apart[known, marker[known]].max() < 0.5
    assert len(set(marker[known])) == known.sum()
    every = np.stack([GEL.positions(frame)[marker] for frame in range(GEL.n_frames)])
    every[:, ~known] = np.nan
    return every


@pytest.mark.long
def test_no_marker_is_accepted_while_wrong(result: xr.Dataset, truth: NDArray[np.float64]) -> None:
    """Markers sheared by 40 px, where neighbours differ by 14 px, err by less than 0.1 px RMS and 1.5 px at most, a
    third of a radius.

    A disc compressed to two thirds on one side is no ellipse: its peak lies up to 1 px beside its centre.
    """
    error = np.linalg.norm(result["position_px"].values - truth, axis=-1)
    assert np.linalg.norm(truth - truth[:1], axis=-1)[np.isfinite(error)].max() > 25
    assert np.nanmax(error) < 1.5
    assert np.sqrt(np.nanmean(error**2)) < 0.1


def test_every_marker_in_view_is_followed(result: xr.Dataset) -> None:
    """In every frame 99 % of the markers that are entirely in view are tracked; lost markers have another status."""
    found, height, width = result["position_px"].values, *GEL.frame_shape
    for frame in range(GEL.n_frames):
        places = GEL.positions(frame)
        whole = np.minimum(places, np.array([width - 1, height - 1]) - places).min(1) > 1.5 * GEL.radius
        rest = GEL.markers
        known = np.minimum(rest, np.array([width - 1, height - 1]) - rest).min(1) > 0  # visible in the frame at rest
        nearest = np.linalg.norm(places[whole & known][:, None] - found[frame][None], axis=-1)
        assert (np.nanmin(nearest, axis=1) < 1.5).mean() >= 0.99, frame
    status = result["status"].values
    assert np.array_equal(status == TrackStatus.TRACKED, np.isfinite(found).all(-1))


def test_displacement_counts_from_rest(result: xr.Dataset, truth: NDArray[np.float64]) -> None:
    moved, expected = result["displacement"].values, GEL_MM_PER_PX * (truth - truth[:1])
    assert np.sqrt(np.nanmean((moved - expected) ** 2)) < 0.006
    assert result["displacement"].attrs["long_name"] == "displacement since rest"


def test_gross_slip_is_flagged_in_its_frame(result: xr.Dataset) -> None:
    """Gross slip is flagged first in its own frame, not while the object drags the gel; when the object is lifted, the
    gel may release as a whole.
    """
    flagged = np.flatnonzero(result["gross_slip"].values)
    assert flagged[0] == GEL.slip_frame


def test_contact_is_there_when_the_object_is(result: xr.Dataset) -> None:
    area = result["gross_contact_area"].values
    pressed = np.array([GEL.pressed(frame) for frame in range(GEL.n_frames)])
    assert not area[pressed == 0].any()
    assert area[pressed == 1].all()


def test_a_recording_that_begins_in_contact_is_read_from_where_it_rests(gel_recording: Path, tmp_path: Path) -> None:
    text = gel_recording.read_text(encoding="utf-8")
    video = (gel_recording.parent / "frames.avi").as_posix()
    text = text.replace('frames = "frames.avi"', f'frames = "{video}"\nfirst_frame = 24')
    (tmp_path / "late.toml").write_text(text, encoding="utf-8")
    late = process(tmp_path / "late.toml", ["displacement", "gross_slip"])
    assert any("not at rest in frame 24" in one for one in json.loads(late.attrs["warnings"]))
    moved = np.linalg.norm(late["displacement"].values, axis=-1) / GEL_MM_PER_PX
    assert np.nanmax(moved[0]) > 20
    assert np.nanmax(moved[-1]) < 0.5
    assert np.flatnonzero(late["gross_slip"].values)[0] == GEL.slip_frame - 24


def test_a_video_without_markers_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "blank.npy", np.full((4, 64, 80), 120, dtype=np.uint8))
    text = gel_scene_text("blank.npy", (64, 80), GEL_MM_PER_PX)
    (tmp_path / "scene.toml").write_text(text.replace("[views", "frame_rate = 25.0\n\n[views", 1), encoding="utf-8")
    with pytest.raises(FingerflowError, match="no printed markers were found"):
        process(tmp_path / "scene.toml")


def test_what_other_kinds_give_is_refused_by_name(gel_recording: Path) -> None:
    with pytest.raises(FingerflowError, match="picture without a finger"):
        process(load_scene(gel_recording), ["printed_real_contact_area"])


def test_the_command_line_writes_its_scene_and_streams_refuse_it(gel_recording: Path, tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    video = str(gel_recording.parent / "frames.avi")
    assert CliRunner().invoke(app, ["init", str(path), "--gel", video, "--mm-per-px", "0.05"]).exit_code == 0
    scene = load_scene(path)
    assert scene.kind == "soft_sensor"
    assert scene.views["camera"].shape == GEL.frame_shape
    assert scene.calibration.mm_per_px == 0.05
    alone = CliRunner().invoke(app, ["init", str(tmp_path / "other.toml"), "--gel", video])
    assert isinstance(alone.exception, FingerflowError)
    assert "--mm-per-px" in str(alone.exception)
    with pytest.raises(SceneError, match="streams cannot play it"):
        read_scene(path, "stream")


@pytest.mark.long
def test_the_report_shows_markers_and_slip(result: xr.Dataset, gel_recording: Path, tmp_path: Path) -> None:
    page = write_report(result, load_scene(gel_recording), tmp_path).read_text(encoding="utf-8")
    assert "Slip of what touches the gel" in page
    told = re.sub(r"base64,[A-Za-z0-9+/=\s]+", "", page).lower()
    assert "skin" not in told.replace(str(tmp_path).lower(), "")
    assert "fingertip" not in told
    assert "markers tracked" in told
    capture = cv2.VideoCapture(str(tmp_path / "overlay.mp4"))
    assert int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)) == GEL.frame_shape[1]  # a single view is shown once


def test_rest_is_the_state_that_returns_and_is_even() -> None:
    """The frames at rest are those that recur with an even lattice, although an object is held for longer than the rest
    lasts.
    """
    x, y = np.meshgrid(np.arange(6.0), np.arange(5.0))
    flat = 30 * np.stack((x, y), axis=-1).reshape(-1, 2)
    bent = flat + 8 * np.exp(-((flat - 70) ** 2).sum(-1, keepdims=True) / 30**2)
    noise = np.random.default_rng(0).normal(0, 0.05, (40, *flat.shape))
    frames = [(flat if k < 6 or k > 33 else bent) + noise[k] for k in range(40)]
    found = find_rest(frames)
    assert found.alike.tolist() == [k < 6 or k > 33 for k in range(40)]


@pytest.mark.skipif(not TACTILE.exists(), reason=f"{TACTILE}: real recordings lie beside the checkout where they are")
@pytest.mark.parametrize("name", ["grasp_bag_of_peanuts", "grasp_marker_pen"])
def test_markers_of_a_real_sensor(name: str, tmp_path: Path) -> None:
    """99 % of the blobs that OpenCV finds entirely in view of a real sensor have a tracked point within 1.5 px, and the
    slip of the object is flagged.
    """
    video = TACTILE / f"{name}.avi"
    (tmp_path / "scene.toml").write_text(gel_scene_text(video.as_posix(), (240, 320), GEL_MM_PER_PX), encoding="utf-8")
    found = process(tmp_path / "scene.toml", ["position_px", "status", "gross_slip"])
    capture, near, missed = cv2.VideoCapture(str(video)), 0, 0
    for places in found["position_px"].values:
        blobs = dark_spots(cv2.cvtColor(capture.read()[1], cv2.COLOR_BGR2GRAY).astype(np.uint8))
        apart = np.linalg.norm(blobs[:, None] - places[None], axis=-1)
        good = np.nanmin(apart, axis=1) < 1.5
        near, missed = near + int(good.sum()), missed + int((~good).sum())
    assert near > 30 * len(found["frame"])
    assert missed <= 0.01 * (near + missed)
    assert found["gross_slip"].values.any()
