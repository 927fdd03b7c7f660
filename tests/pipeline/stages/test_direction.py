"""Tests of forward and backward tracking on the same press at 40 frames/s, against its truth.

Both are below the truth by the motion of the skin between its onset and the first frame with contact.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from fingerflow import load_scene, process
from fingerflow.synthetic import Press, write_recording

PRESS = Press(n_frames=40, frame_rate=40.0, frames_before_trigger=2)
DIRECTIONS = ("forward", "backward")


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, xr.Dataset]:
    folder: Path = tmp_path_factory.mktemp("direction") / "press"
    write_recording(folder, PRESS)
    scene = load_scene(folder / "scene.toml")
    # Without a stream region both directions seed points wherever skin touches at some time.
    stream = replace(scene.stream, region=None)
    outputs = ["median_divergence", "strain_energy", "position", "onset_frame"]
    return {
        direction: process(
            replace(scene, stream=stream, tracking=replace(scene.tracking, direction=direction)), outputs, device="cpu"
        )
        for direction in DIRECTIONS
    }


def test_forward_and_backward_tracking_agree(results: dict[str, xr.Dataset]) -> None:
    """The medians of both directions agree to 6 % and the energies to 10 %. Measured: 5.3 and 7.3 %; 400 instead of 700
    points change the medians by 4 to 8 % and the energies by 0.5 %.
    """
    for name, limit in (("median_divergence", 0.06), ("strain_energy", 0.1)):
        forward, backward = (float(results[direction][name][-1]) for direction in DIRECTIONS)
        assert abs(backward / forward - 1) < limit, name


def test_forward_and_backward_tracking_give_the_true_divergence(results: dict[str, xr.Dataset]) -> None:
    """Both directions give the true median divergence of 34 um/mm to 6 % at 40 frames/s."""
    truth = PRESS.truth.medians(39).divergence
    for direction in DIRECTIONS:
        assert 0.94 < float(results[direction]["median_divergence"][-1]) / truth < 1.06, direction


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_no_motion_before_the_first_frame_with_contact_is_missing(
    results: dict[str, xr.Dataset], direction: str
) -> None:
    """The error of the displacement since the true onset is uncorrelated with the step at onset."""
    result = results[direction]
    position, onset = result["position"].values, result["onset_frame"].values
    touched = np.flatnonzero((onset > 0) & np.isfinite(position[-1]).all(-1))
    first, before = position[onset[touched], touched], position[onset[touched] - 1, touched]
    material = PRESS.truth.material(position[-1, touched], 39)
    exact = PRESS.truth.displacement(material, 39)
    missing = exact - (position[-1, touched] - result["reference_position"].values[touched])
    step = first - before
    known = np.isfinite(missing).all(-1) & np.isfinite(step).all(-1)
    share = (missing[known] * step[known]).sum() / (step[known] ** 2).sum()
    assert abs(share) < 0.18  # 0.152 backward
