"""Tests of unusable frames, which change no result of other frames: on a press and a slide, each kind of bad frame."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import xarray as xr

from fingerflow import process
from fingerflow.errors import FingerflowError
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.recordings.frames.recording import FileRecording
from fingerflow.schema.scene import Scene
from fingerflow.schema.variables import FRAME_STATUS, LOADING
from tests.small_trials import (
    SPOILED,
    TRIALS,
    WIDTH,
    dim_contact,
    other_noise,
    scene_beside,
    warnings_of,
    write_scene_of_bundle,
)

Frame = np.ndarray[Any, Any]
FAR = "jumps_and_returns"


def _of_itself(spoil: Callable[[Frame], Frame], frame: Frame, other: Frame, k: int) -> Frame:
    return spoil(frame)


#: (function that returns a spoiled frame from it, the frame half a recording away and its number; status).
KINDS: dict[str, tuple[Callable[[Frame, Frame, int], Frame], str]] = {
    **{name: (partial(_of_itself, spoil), status) for name, (spoil, status) in SPOILED.items()},
    "dim topography view": (lambda frame, *_: np.roll(dim_contact(np.roll(frame, WIDTH, 1)), WIDTH, 1), FAR),
    "noise": (lambda frame, _, k: np.random.default_rng(k).integers(0, 256, frame.shape), FAR),
    "other moment": (lambda _, other, k: other_noise(other, k), FAR),
}
OF_FORCES = {variable.name for variable in LOADING}
AREAS = ("real_contact_area", "gross_contact_area", "contact_threshold")


class Clean(NamedTuple):
    scene: Scene
    frames: Frame
    result: xr.Dataset


@pytest.fixture(scope="module", params=["press", pytest.param("slide", marks=pytest.mark.long)])
def clean(request: pytest.FixtureRequest, trials: Path, tmp_path_factory: pytest.TempPathFactory) -> Clean:
    folder, recording = tmp_path_factory.mktemp("clean"), trials / "press"
    if request.param == "slide":
        recording = write_scene_of_bundle(folder / "slide", replace(TRIALS["slide"], n_frames=120)).parent
    scene = scene_beside(recording, folder, {"threshold = 0.27": 'threshold = "reference_frame"'})
    return Clean(scene, np.load(scene.recording.frames), process(scene))


def with_frames(clean: Clean, frames: Frame, folder: Path) -> Scene:
    np.save(folder / "frames.npy", frames)
    return replace(clean.scene, recording=replace(clean.scene.recording, frames=folder / "frames.npy"))


def status_of(result: xr.Dataset) -> dict[int, str]:
    values = result["frame_status"].values
    return {int(k): FRAME_STATUS[values[k]] for k in np.flatnonzero(values)}


@pytest.mark.parametrize("first", [0, 1])
def test_what_a_bad_frame_gives_is_nan_and_the_rest_stays(clean: Clean, first: int, tmp_path: Path) -> None:
    """Results of bad frames, here every other kind, are NaN, and results of the other frames stay as they are.

    Areas agree to 0.5 %: the threshold changes if the bad frame is the one with the largest force. Positions and
    medians agree within their stated deviations. The first frame is good here, since in another frame other points
    would be seeded.
    """
    entering = "slide" in str(clean.scene.recording.frames)
    assert status_of(clean.result) == {}
    assert "frame_status" not in warnings_of(clean.result)
    count = len(clean.frames)
    kinds = dict(zip(range(9, count, 11), list(KINDS)[first::2], strict=False))
    assert len(kinds) == len(list(KINDS)[first::2])
    frames, places = clean.frames.copy(), list(kinds)
    for k, kind in kinds.items():
        frames[k] = KINDS[kind][0](clean.frames[k], clean.frames[(k + count // 2) % count], k)
    result = process(with_frames(clean, frames, tmp_path))
    assert status_of(result) == {k: KINDS[kind][1] for k, kind in kinds.items()}
    good = np.setdiff1d(np.arange(count), places)
    for name, variable in result.data_vars.items():
        # Forces are known in bad frames too, and so are results of forces alone.
        if variable.dims[:1] == ("frame",) and variable.dtype.kind == "f" and name not in OF_FORCES:
            assert np.isnan(variable.values[places]).all(), name
    assert (result["status"].values[places] == TrackStatus.FRAME_NOT_USABLE).all()
    # After a gap, a point that has moved unlike its neighbours may be searched for elsewhere. On the slide, which
    # loses a quarter of its points anyway, a tenth of the points have another status.
    equal = (result["status"].values[good] == clean.result["status"].values[good]).mean()
    assert equal > (0.85 if entering else 0.97)
    for name in AREAS:
        np.testing.assert_allclose(result[name].values[good], clean.result[name].values[good], rtol=5e-3, err_msg=name)
    moved = result["position_px"].values[good] - clean.result["position_px"].values[good]
    far = np.abs(moved / clean.result["position_std_px"].values[good][..., None].clip(0.01))
    # On a slide of several px per frame, points at the edge of the view are found again elsewhere, or later.
    assert np.nanquantile(far, 0.99) < 1.5
    # In a slide, entering skin is strained relative to skin that touched before, so single points change the energy.
    for name in ("median_divergence", "median_curl", *(() if entering else ("strain_energy",))):
        value, deviation = (clean.result[one].values[good] for one in (name, f"{name}_std"))
        off = np.abs(result[name].values[good] - value)
        known = np.isfinite(off)
        assert known.sum() > 0.9 * np.isfinite(value).sum(), name
        # A point may be covered for the first time one frame later; the deviations include that.
        assert (off[known] <= 3 * deviation[known] + 1e-12).all(), name


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


def test_a_frame_that_comes_twice_is_found(clean: Clean, tmp_path: Path) -> None:
    frames, places = clean.frames.copy(), [13, 25, 37, len(clean.frames) - 1]
    for k in places:
        frames[k] = frames[k - 1]
    result = process(with_frames(clean, frames, tmp_path), ["frame_status"])
    assert status_of(result) == dict.fromkeys(places, "repeated")
    half = np.repeat(clean.frames[::2], 2, axis=0)
    result = process(with_frames(clean, half, tmp_path), ["frame_status"])
    assert status_of(result) == {}
    assert "50% of the frames repeat another one" in warnings_of(result)


def test_nothing_but_bad_frames_is_no_recording(clean: Clean, tmp_path: Path) -> None:
    message = rf"frames\.npy: no frame can be measured: {len(clean.frames)} dark frames\. Check"
    with pytest.raises(FingerflowError, match=message):
        process(with_frames(clean, np.full_like(clean.frames, 8), tmp_path), ["real_contact_area"])


def test_errors_that_the_decoder_got_over_are_told(clean: Clean, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FileRecording, "doubtful", {3: "error while decoding MB 3 0", 40: "no frame!"})
    said = warnings_of(process(clean.scene, ["frame_status"]))
    assert "the decoder reported errors at 3, 40 (error while decoding MB 3 0); their pixels may be wrong" in said
