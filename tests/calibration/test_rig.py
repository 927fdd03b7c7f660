"""Tests of the calibration on the real frames of the rig, without coordinates set by hand."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from fingerflow.calibration import calibrate, draw_overlay
from fingerflow.recordings import open_recording
from fingerflow.schema.calibration_file import read_calibration
from fingerflow.schema.views import View

VIEWS = {"topography": View((0, 512), (0, 640)), "contact": View((0, 512), (640, 1280))}


@pytest.fixture(scope="module")
def frames(shared_data: Path) -> dict[str, np.ndarray]:
    names = {"target": "triangle1.jpg", "ring": "piece.jpg", "empty": "empty.jpg"}
    return {key: np.asarray(open_recording(shared_data / "rig" / name)[0]) for key, name in names.items()}


def test_discs_ring_and_transform(frames: dict[str, np.ndarray], tmp_path: Path) -> None:
    found = calibrate(frames["target"], frames["ring"], VIEWS, background=frames["empty"])
    assert len(found.discs) == 3
    assert found.mm_per_px == pytest.approx(0.034, rel=0.03)  # about 80 px for 2.75 mm, as the notes of the data say
    assert found.affine is not None
    assert np.linalg.det(found.affine.matrix[:, :2]) == pytest.approx(1.0, abs=0.25)
    draw_overlay(tmp_path / "overlay.png", found, frames["target"], frames["ring"])
    assert imread(tmp_path / "overlay.png").shape[0] > 300
    (tmp_path / "calibration.toml").write_text(found.to_toml())
    again, _ = read_calibration(tmp_path / "calibration.toml")
    assert again["mm_per_px"] == found.mm_per_px
    np.testing.assert_array_equal(again["topography_to_contact"], found.affine.matrix)
