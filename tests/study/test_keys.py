"""What has to be done again, and what not."""

import os
from pathlib import Path

import numpy as np
import pytest

from fingerflow import load_scene, process
from fingerflow.study import keys as room
from fingerflow.study.keys import code_of, keys_of, look_at, same_content


def _changed(folder: Path, old: str, new: str) -> room.Keys:
    text = (folder / "scene.toml").read_text(encoding="utf-8")
    assert old in text
    (folder / "other.toml").write_text(text.replace(old, new, 1), encoding="utf-8")
    return keys_of(load_scene(folder / "other.toml"))


@pytest.fixture
def folder(lab: Path) -> Path:
    return lab / "p01/0um/trial1"


@pytest.mark.parametrize(
    ("old", "new", "first"),
    [
        ("gauge_length_mm = 1.6", "gauge_length_mm = 1.4", "numbers"),
        ("depth_mm = 2.0", "depth_mm = 1.0", "numbers"),
        ("points = 700", "points = 300", "pictures"),
        ("median_px = 3", "median_px = 5", "pictures"),
        ("mm_per_px = 0.0325", "mm_per_px = 0.0326", "pictures"),
        ("# A scene", "# The scene", None),
    ],
)
def test_settings(folder: Path, old: str, new: str, first: str | None) -> None:
    before, now = keys_of(load_scene(folder / "scene.toml")), _changed(folder, old, new)
    parts = ("pictures", "numbers", "row")
    different = [part for part in parts if getattr(before, part) != getattr(now, part)]
    assert different == ([] if first is None else list(parts[parts.index(first) :]))


def test_a_recording_counts_by_its_content(folder: Path) -> None:
    scene = load_scene(folder / "scene.toml")
    before = keys_of(scene)
    os.utime(folder / "frames.npy", ns=(1, 1))
    touched = keys_of(scene, before.inputs)
    assert touched.row == before.row
    assert same_content(before.inputs["recording.frames"], touched.inputs["recording.frames"])
    frames = np.load(folder / "frames.npy")
    frames[5, 50, 50] ^= 1
    np.save(folder / "frames.npy", frames)
    assert keys_of(scene, before.inputs).pictures != before.pictures


def test_a_large_file_that_was_touched_is_not_certainly_the_same(tmp_path: Path) -> None:
    path = tmp_path / "large.bin"
    path.write_bytes(bytes(room._WHOLE_BYTES + 1))
    before = look_at(path)
    assert same_content(before, look_at(path, before))
    os.utime(path, ns=(1, 1))
    assert not same_content(before, look_at(path, before))


def test_code_behind_the_parts() -> None:
    tracking = room._behind({"fingerflow.stages.tracking"})
    assert {"fingerflow.ops.templates", "fingerflow.kernels.tracking", "fingerflow.scene"} <= set(tracking)
    assert not {"fingerflow.stages.fields", "fingerflow.report.page", "fingerflow.cli"} & set(tracking)
    assert len({code_of(part) for part in ("pictures", "numbers", "row")}) == 3


def test_pictures_do_not_depend_on_settings_of_numbers(folder: Path) -> None:
    """What `keys` takes for granted: [fields] and [slip] change nothing of contact and tracks."""
    text = (folder / "scene.toml").read_text(encoding="utf-8")
    other = text.replace("gauge_length_mm = 1.6", "gauge_length_mm = 0.8").replace("depth_mm = 2.0", "depth_mm = 1.0")
    other = other.replace('strain = "green_lagrange"', 'strain = "infinitesimal"').replace("0.05\n", "0.3\n")
    (folder / "other.toml").write_text(other, encoding="utf-8")
    names = ["position", "status", "gross_contact_area", "real_contact_area", "in_contact", "frame_status"]
    one, two = (process(folder / name, names) for name in ("scene.toml", "other.toml"))
    for name in one.data_vars:
        np.testing.assert_array_equal(one[name].values, two[name].values)


def test_numbers_from_earlier_pictures_are_those_of_a_whole_run(folder: Path) -> None:
    process(folder / "scene.toml", to=folder / "first.h5").close()
    text = (folder / "scene.toml").read_text(encoding="utf-8")
    (folder / "other.toml").write_text(text.replace("gauge_length_mm = 1.6", "gauge_length_mm = 1.2"), encoding="utf-8")
    whole = process(folder / "other.toml")
    short = process(folder / "other.toml", to=folder / "short.h5", pictures_of=folder / "first.h5").load()
    assert set(whole.data_vars) == set(short.data_vars)
    for name in whole.data_vars:
        np.testing.assert_array_equal(whole[name].values, short[name].values)
        assert set(whole[name].attrs) == set(short[name].attrs)
    assert whole.attrs["warnings"] == short.attrs["warnings"]
    assert "decoding" not in short.attrs["stage_seconds"]
    first = process(folder / "scene.toml")
    assert not np.array_equal(first["divergence"].values, short["divergence"].values, equal_nan=True)


def test_a_result_of_other_frames_is_not_taken(folder: Path, lab: Path) -> None:
    process(folder / "scene.toml", to=folder / "first.h5").close()
    other = lab / "p02/2um/trial3/scene.toml"
    found = process(other, pictures_of=folder / "first.h5")
    assert "decoding" in found.attrs["stage_seconds"]
