"""Tests of scene files: valid files are read, errors are named with their line."""

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fingerflow.errors import FingerflowError
from fingerflow.schema.scene import load_scene, scene_of_settings
from fingerflow.schema.scene_template import scene_text

MATRIX = [[1.01, -0.01, 3.4], [0.01, 1.01, -6.2]]
QUOTED = '"points"'
TOPOGRAPHY_TABLE = """[views.topography]
rows = [0, 512]
columns = [0, 640]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("frames.npy", "empty.npy", "forces.csv"):
        (tmp_path / name).write_bytes(b"")
    return tmp_path


def write(folder: Path, old: str = "", new: str = "", **settings: Any) -> Path:
    given = {
        "frames": "frames.npy",
        "background": "empty.npy",
        "forces": "forces.csv",
        "calibration": f"mm_per_px = 0.0325\ntopography_to_contact = {MATRIX}",
    }
    text = re.sub(r" +# .*", "", scene_text(**{**given, **settings}))  # without comments after keys
    assert old in text
    path = folder / "scene.toml"
    path.write_text(text.replace(old, new) if old else text, encoding="utf-8")
    return path


def message_of(path: Path) -> str:
    with pytest.raises(FingerflowError) as caught:
        load_scene(path)
    return str(caught.value)


def line_number(path: Path, start: str) -> int:
    return next(n for n, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1) if line.startswith(start))


def test_template_is_a_scene(folder: Path) -> None:
    scene = load_scene(write(folder))
    assert scene.recording.frames == folder.resolve() / "frames.npy"
    assert scene.views.topography is not None
    assert scene.views.contact.columns == (640, 1280)
    assert scene.tracking.window_px == 25
    assert np.asarray(scene.calibration.topography_to_contact).shape == (2, 3)


def test_whole_numbers_are_numbers(folder: Path) -> None:
    assert load_scene(write(folder, "gauge_length_mm = 1.6", "gauge_length_mm = 2")).fields.gauge_length_mm == 2.0


def test_keys_in_other_spellings_have_their_line(folder: Path) -> None:
    """Errors in inline tables, dotted and quoted keys, which are the same TOML, name their line."""
    inline = write(folder, "[tracking]\npoints = 700\n", '[tracking]\n"points"= 1\n')
    assert f"line {line_number(inline, QUOTED)}: tracking.points is 1" in message_of(inline)
    text = "fields = { gauge_length_mm = -1 }\n" + write(folder).read_text().split("[fields]")[0]
    inline.write_text(text)
    assert "line 1: fields.gauge_length_mm is -1" in message_of(inline)
    inline.write_text("\n\nfields.gauge_length_mm = -1\n" + text.partition("\n")[2])
    assert "line 3: fields.gauge_length_mm is -1" in message_of(inline)


def test_a_missing_key_is_reported(folder: Path) -> None:
    path = write(folder, 'frames = "frames.npy"', "")
    assert f"line {line_number(path, '[recording]')}: recording.frames is missing; add it" in message_of(path)
    (folder / "empty.toml").write_text("")
    assert {line.split(": ")[1].split()[0] for line in message_of(folder / "empty.toml").splitlines()} == {
        "recording",
        "views",
        "background",
        "calibration",
    }


def test_every_problem_has_a_line_of_its_own(folder: Path) -> None:
    path = write(folder, "points = 700\nwindow_px = 25", "points = 1\nwindow_px = 4\npixels = 3")
    assert [line.split(" is ")[0].split(": ")[1] for line in message_of(path).splitlines()] == [
        "tracking.points",
        "tracking.window_px",
        "tracking.pixels",
    ]


@pytest.mark.parametrize(
    "name", ["C:\\Users\\new\\table.cine", 'a "b" c.npy', "it's\ttab.npy", "名前 ü.npy", "del\x7f.npy", "a # b.npy"]
)
def test_paths_survive_the_template(name: str) -> None:
    values = tomllib.loads(scene_text(frames=name, background=name, dark=name, forces=name))
    assert values["recording"]["frames"] == values["background"]["frames"] == values["background"]["dark"] == name
    assert values["forces"]["file"] == name


def test_a_profile_takes_the_place_of_defaults_and_of_nothing_else(folder: Path) -> None:
    """The template states all defaults. Settings of a result, which name the profile and its keys, are read again."""
    profile = 'profile = "willemet_2021"\n[recording]'
    scene = load_scene(write(folder, "[recording]", profile))
    assert (scene.fields.reference, scene.fields.strain) == ("dilated_onset", "as_printed")
    assert scene_of_settings(scene.as_json()).fields == scene.fields
    path = write(folder, "[recording]", profile)
    path.write_text(path.read_text("utf-8").replace('"green_lagrange"', '"infinitesimal"', 1), "utf-8")
    assert "fields.strain is 'infinitesimal': the profile willemet_2021 has 'as_printed'" in message_of(path)


def test_settings_of_results_of_other_versions(folder: Path) -> None:
    scene = load_scene(write(folder))
    older = json.loads(scene.as_json())
    assert older.pop("format") == 1
    assert scene_of_settings(json.dumps(older)) == scene_of_settings(scene.as_json())
    for changed, said in (({"format": 2}, "format 2; update"), ({"fields": {"gauge_mm": 1.6}}, "fields.gauge_mm")):
        with pytest.raises(FingerflowError, match=said):
            scene_of_settings(json.dumps(older | changed))


def test_a_scene_has_a_kind(folder: Path) -> None:
    """A scene is a press, or slip if it has a [slip] table, unless it states its kind."""
    assert load_scene(write(folder)).kind == "press"
    assert load_scene(write(folder, slip=True)).kind == "slip"
    assert load_scene(write(folder, "[recording]", 'kind = "slip"\n[recording]')).kind == "slip"
    assert load_scene(write(folder, "[recording]", 'kind = "press"\n[recording]', slip=True)).kind == "press"


def test_a_scene_says_what_it_has(folder: Path) -> None:
    scene = load_scene(write(folder))
    for need in ("views.topography", "forces", "forces.tangential", "calibration", "tracking.points", "forces.trigger"):
        assert scene.has(need), need
    for need in ("forces.time", "background.dark", "stream.region"):
        assert not scene.has(need), need
    bare = load_scene(write(folder, TOPOGRAPHY_TABLE, "", forces=None))
    for need in ("views.topography", "forces", "forces.tangential"):
        assert not bare.has(need), need
    assert not scene.has("views.markers")  # a view of another kind of scene
    with pytest.raises(AttributeError):
        scene.has("tracking.pionts")
