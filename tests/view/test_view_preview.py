"""Tests of the previews of the page: contact, points and forces shown before processing are those of `process`."""

from pathlib import Path

import numpy as np
import pytest

from fingerflow import load_scene, process
from fingerflow.results.result import load_result
from fingerflow.schema.scene import scene_of_text
from fingerflow.view.preview import Previewer

CONTACT = ("contact_threshold", "real_contact_area", "gross_contact_area", "ellipse_center", "ellipse_angle")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("median_px = 3", "median_px = 5"),
        ('threshold = "reference_frame"', "threshold = 0.3"),
        ('threshold = "reference_frame"', 'threshold = "per_frame"'),
        ("gross_radius_px = 8", "gross_radius_px = 6"),
    ],
)
def test_contact_is_that_of_process(processed: Path, old: str, new: str) -> None:
    text = (processed / "scene.toml").read_text(encoding="utf-8")
    assert old in text
    scene = scene_of_text(text.replace(old, new), processed / "scene.toml")
    before = Previewer(load_scene(processed / "scene.toml"))
    preview = Previewer(scene, before)  # as on the page, where each previewer takes over from the one before
    result = process(scene, [*CONTACT])
    for frame in (0, 5, 11, 6):
        mask, numbers = preview.contact(frame)
        for name in CONTACT:
            # Equal with the compiled kernels; portable float32 sums depend on the number of frames at a time.
            np.testing.assert_allclose(numbers[name], result[name].values[frame], rtol=1e-6, err_msg=name)
        area = mask.sum() * scene.calibration.mm_per_px**2
        assert area == pytest.approx(float(result["real_contact_area"][frame]), rel=1e-12)
    settled = load_result(processed / "result.h5")  # result of the settings before the change, which must differ
    assert any((settled[name].values != result[name].values).any() for name in CONTACT)


@pytest.mark.parametrize("direction", ["forward", "backward"])
def test_points_are_those_of_process(processed: Path, direction: str) -> None:
    text = (processed / "scene.toml").read_text(encoding="utf-8").replace('"forward"', f'"{direction}"', 1)
    scene = scene_of_text(text, processed / "scene.toml")
    assert scene.tracking.direction == direction
    points, frame, warnings = Previewer(scene).chosen()
    result = process(scene, ["position_px"])
    assert frame == (0 if direction == "forward" else 11)
    np.testing.assert_array_equal(points, result["position_px"].values[frame])
    assert any("points" in one for one in warnings)  # the view is too small for 700 points


def test_forces_are_those_of_process(processed: Path) -> None:
    scene = load_scene(processed / "scene.toml")
    result = process(scene, ["normal_force", "tangential_force", "load_ratio"])
    found = Previewer(scene).forces()
    assert set(found) == {"normal_force", "tangential_force", "load_ratio"}
    for name, values in found.items():
        np.testing.assert_array_equal(values, result[name].values)


def test_warnings_do_not_come_together_over_many_changes(processed: Path) -> None:
    scene = load_scene(processed / "scene.toml")
    preview = Previewer(scene)
    first = preview.warnings
    for _ in range(3):
        preview = Previewer(scene, preview)
        preview.chosen()
        preview.contact(3)
    assert preview.warnings == first
