"""Tests of the previews of the page: contact, points, forces and markers shown before processing are those of
`process`.
"""

from pathlib import Path

import numpy as np
import pytest

from fingerflow import load_scene, process
from fingerflow.results.result import load_result
from fingerflow.schema.scene import scene_of_text
from fingerflow.view.preview import Previewer
from fingerflow.view.sensor_preview import SensorPreviewer

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
        found = preview.contact(frame)
        for name in CONTACT:
            # Equal with the compiled kernels; portable float32 sums depend on the number of frames at a time.
            np.testing.assert_allclose(found.numbers[name], result[name].values[frame], rtol=1e-6, err_msg=name)
        area = found.mask.sum() * scene.calibration.mm_per_px**2
        assert area == pytest.approx(float(result["real_contact_area"][frame]), rel=1e-12)
    settled = load_result(processed / "result.h5")  # result of the settings before the change, which must differ
    assert any((settled[name].values != result[name].values).any() for name in CONTACT)


@pytest.mark.parametrize("direction", ["forward", "backward"])
def test_points_are_those_of_process(processed: Path, direction: str) -> None:
    text = (processed / "scene.toml").read_text(encoding="utf-8").replace('"forward"', f'"{direction}"', 1)
    scene = scene_of_text(text, processed / "scene.toml")
    assert scene.tracking.direction == direction
    chosen = Previewer(scene).chosen()
    result = process(scene, ["position_px"])
    assert chosen.frame == (0 if direction == "forward" else 11)
    np.testing.assert_array_equal(chosen.points, result["position_px"].values[chosen.frame])
    assert any("points" in one for one in chosen.warnings)  # the view is too small for 700 points


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


def test_markers_of_a_soft_sensor_are_those_of_process(gel_recording: Path) -> None:
    scene = load_scene(gel_recording)
    result = process(scene, ["position_px", "gross_contact_area", "gross_contact_region", "contact_threshold"])
    preview = SensorPreviewer(scene)
    shared = []
    for frame in (0, 11, 24, 27, 39):  # at rest, pressed, dragged, after gross slip, at rest; 11, 27: not sampled
        found = preview.contact(frame)
        assert found.markers is not None
        followed = result["position_px"].values[frame]
        apart = np.linalg.norm(followed[:, None] - found.markers, axis=-1).min(1)
        np.testing.assert_array_less(apart[np.isfinite(apart)], 1e-9)  # px
        region = result["gross_contact_region"].values[frame] > 0
        area = float(result["gross_contact_area"].values[frame])
        assert found.numbers["gross_contact_area"] == pytest.approx(area, rel=0.1, abs=0.5)
        mine = found.mask[::4, ::4]
        if region.any():
            shared.append((mine & region).sum() / (mine | region).sum())
        else:
            assert not mine.any()
    # The mean picture at rest and the threshold come from 32 frames here and from 40 there.
    assert len(shared) == 3
    assert min(shared) > 0.9
    assert preview.contact(24).mask.shape == (240, 320)


def test_the_threshold_of_a_soft_sensor_moves_its_contact(gel_recording: Path) -> None:
    text = gel_recording.read_text(encoding="utf-8")
    found = []
    before: SensorPreviewer | None = None
    for threshold in (0.05, 0.2):  # the light changes by less than 0.2: the motion of markers shows contact
        before = SensorPreviewer(scene_of_text(f"{text}\n[contact]\nthreshold = {threshold}\n", gel_recording), before)
        found.append(before.contact(17))
        assert found[-1].numbers["contact_threshold"] == pytest.approx(threshold)
    assert 0 < 2 * found[0].mask.sum() < found[1].mask.sum()
    np.testing.assert_array_equal(found[0].markers, found[1].markers)
