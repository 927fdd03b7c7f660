"""Tests of [fields] reference on a press that slides while it grows: onset, first frame, a frame and a time."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from fingerflow import load_scene, process
from fingerflow.errors import FingerflowError
from fingerflow.schema.scene import Scene
from fingerflow.synthetic import Press, write_recording
from tests.pipeline.stages.conftest import Change
from tests.small_trials import warnings_of

PRESS = Press(
    n_frames=40,
    frame_rate=40.0,
    frames_before_trigger=2,
    frame_shape=(320, 800),
    semi_axes=(3.4, 2.8),
    finger=(5.0, 4.0),
    shift=(0.5, -0.25),  # mm: 17 px of sliding
)
LOOKED = (16, 24, 32, 39)  # frames with a contact of 10 mm2 or more


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    folder: Path = tmp_path_factory.mktemp("sliding") / "press"
    write_recording(folder, PRESS)
    return load_scene(folder / "scene.toml")


def counted_from(scene: Scene, reference: str | int) -> xr.Dataset:
    return process(replace(scene, fields=replace(scene.fields, reference=reference)))


@pytest.mark.parametrize(("reference", "frame"), [("first_frame", 0), ("0.7 s", 30)])
def test_every_frame_gives_what_is_true_for_it(scene: Scene, reference: str | int, frame: int) -> None:
    """Strain and displacement counted from a frame agree with the truth of that reference.

    The limit of the medians is twice the effect of border errors on this small contact (0.4 um/mm). The displacement is
    a median over points, which are not spread as evenly as the grid of the truth (7 um of 510).
    """
    result, truth = counted_from(scene, reference), PRESS.truth
    assert result["divergence"].attrs["reference_frame"] == frame
    assert f"frame {frame}, {PRESS.times[frame]:.4g} s" in result["median_strain"].attrs["reference"]
    for k in LOOKED:
        true = truth.medians(k, reference=frame)
        assert 1000 * abs(result["median_divergence"].values[k] - true.divergence) < 0.8, k
        assert 1000 * abs(result["median_curl"].values[k] - true.curl) < 0.8, k
        expected = np.array((true.exx, true.eyy, true.exy))
        assert 1000 * np.abs(result["median_strain"].values[k] - expected).max() < 0.8, k
        assert abs(result["global_displacement_vector"].values[k, 0] - true.displacement_x) < 0.01, k
    material = truth.material(truth.topography_positions(result["position_px"].values[0]), 0)
    error = result["displacement"].values[36] - truth.displacement(material, 36, reference=frame)
    known = np.isfinite(error).all(-1)
    assert known.mean() > 0.5  # points lie in a rectangle around the contact
    assert np.sqrt((error[known] ** 2).mean()) < 0.001  # mm: 0.03 px
    stated = result["displacement_std"].values[36][known]
    assert 0.7 < np.sqrt((error[known] ** 2).mean() / (stated**2).mean()) < 1.4
    assert not np.nan_to_num(result["displacement"].values[frame]).any()


def test_what_is_unknown_in_the_reference_is_said(changed: Change, frames: np.ndarray[Any, Any]) -> None:
    """Points lost in the reference frame, behind a patch of the topography view, have no displacement, and a warning
    counts them. A frame outside the recording or without light is refused.
    """
    for reference, dark, message in (
        ("8", 0, r"scene\.toml.*fields\.reference is 8, and the frames that count are 0 to 7, .*; give one of them"),
        ('"2 s"', 0, r"fields\.reference is '2 s', and the frames .* 0 to 7, from -0.125 to 0.75 s"),
        ("5", 5, r"fields\.reference is 5, which is frame 5: it is dark.*take frame 4"),
    ):
        pictures = frames.copy()
        if dark:
            pictures[dark] = 0
        with pytest.raises(FingerflowError, match=message):
            process(changed({'reference = "onset"': f"reference = {reference}"}, frames=pictures))
    patched = frames.copy()
    patched[5:, 30:60, 40:70] = 40
    result = process(changed({'reference = "onset"': "reference = 5"}, frames=patched))
    lost = ~np.isfinite(result["position"].values[5]).all(-1)
    assert lost.sum() > 10
    assert np.isnan(result["displacement"].values[:, lost]).all()
    assert "are not known in fields.reference, frame 5" in warnings_of(result)
