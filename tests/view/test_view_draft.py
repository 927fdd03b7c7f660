"""Tests of drafts of a scene file: comments are kept, files that others have changed are not replaced without leave,
and no wrong scene is written.
"""

import re
import tomllib
from pathlib import Path

import pytest

from fingerflow import load_scene, open_recording
from fingerflow.errors import FingerflowError
from fingerflow.schema.scene import scene_of_settings
from fingerflow.view.draft import Draft, NeedsLeaveError
from fingerflow.view.open_path import open_path


def test_a_change_leaves_the_rest_of_the_file_as_it_was(press: Path) -> None:
    path = press / "scene.toml"
    before = path.read_text(encoding="utf-8").splitlines()
    draft = Draft.read(path)
    assert draft.is_stored
    draft.set(("contact", "median_px"), 5)
    draft.set(("views", "contact", "columns"), [130, 240])
    assert not draft.is_stored
    draft.write()
    after = path.read_text(encoding="utf-8").splitlines()
    changed = [(old, new) for old, new in zip(before, after, strict=True) if old != new]
    assert len(changed) == 2
    assert [new.split("#")[0].split() for _, new in changed] == [
        ["columns", "=", "[130,", "240]"],
        ["median_px", "=", "5"],
    ]
    assert changed[1][0].partition("#")[2] == changed[1][1].partition("#")[2]  # the comment of the changed line
    assert load_scene(path).contact.median_px == 5


def test_a_key_that_is_left_out_goes_with_its_empty_table(press: Path) -> None:
    draft = Draft.read(press / "scene.toml")
    for key in list(draft.values()["forces"]):
        draft.set(("forces", key), None)
    assert "forces" not in draft.values()
    assert draft.scene().forces is None
    draft.set(("slip", "stuck_mm"), 0.05)
    assert draft.scene_kind() == "slip"


def test_what_was_changed_elsewhere_meanwhile_is_replaced_with_leave_alone(press: Path) -> None:
    path = press / "scene.toml"
    draft = Draft.read(path)
    draft.set(("contact", "median_px"), 5)
    path.write_text("# mine\n" + path.read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(NeedsLeaveError, match=r"scene\.toml exists"):
        draft.write()
    assert path.read_text(encoding="utf-8").startswith("# mine")
    draft.write(replace=True)
    assert load_scene(path).contact.median_px == 5
    other = press / "notes.toml"
    other.write_text("views = 1", encoding="utf-8")
    with pytest.raises(NeedsLeaveError):
        draft.write(other)
    with pytest.raises(FingerflowError, match="is an input"):
        draft.write(press / "forces.csv", replace=True)
    assert other.read_text(encoding="utf-8") == "views = 1"


@pytest.mark.parametrize(
    ("name", "content"),
    [("result.h5", b"\x89HDF\r\n"), ("a.csv", b"frame,time (s)\n0,0\n"), ("study.toml", b"[study]"), ("store", None)],
)
def test_a_scene_replaces_no_file_of_another_kind(press: Path, name: str, content: bytes | None) -> None:
    draft, other = Draft.read(press / "scene.toml"), press / name
    other.mkdir() if content is None else other.write_bytes(content)
    (press / "link.toml").symlink_to(other)
    for path in (other, press / "link.toml"):
        with pytest.raises(FingerflowError, match=r"not valid TOML|is not UTF-8 text|is a folder|is no scene"):
            draft.write(path, replace=True)
    assert other.is_dir() if content is None else other.read_bytes() == content


def test_nothing_wrong_is_written(press: Path) -> None:
    path = press / "scene.toml"
    before = path.read_bytes()
    draft = Draft.read(path)
    draft.set(("contact", "median_px"), 4)
    draft.set(("tracking", "pionts"), 4)
    assert {one["key"]: one["field"] for one in draft.problems()} == {
        "contact.median_px": "Contact: median filter",
        "tracking.pionts": "tracking.pionts",  # has no field on the page
    }
    with pytest.raises(FingerflowError, match="4 is even"):
        draft.write()
    assert path.read_bytes() == before
    assert not [one for one in press.iterdir() if one.name.startswith(".")]


def test_a_recording_begins_a_scene_that_says_what_is_missing(press: Path) -> None:
    with open_recording(press / "frames.npy") as recording:
        draft = Draft.create(recording)
    assert draft.path == press / "scene-2.toml"  # scene.toml exists already
    assert draft.values()["views"] == {
        "contact": {"rows": [0, 96], "columns": [120, 240]},
        "topography": {"rows": [0, 96], "columns": [0, 120]},
    }
    assert {one["key"] for one in draft.problems()} == {"background.frames", "calibration.mm_per_px"}
    draft.set(("background", "frames"), "empty.npy")
    draft.set(("calibration", "mm_per_px"), 0.0325)
    draft.set(("calibration", "topography_to_contact"), [[1.0, 0.0, 2.0], [0.0, 1.0, -3.0]])
    assert not draft.problems()
    assert load_scene(draft.write()).views.contact.columns == (120, 240)


def test_another_kind_has_its_own_views(press: Path) -> None:
    draft = Draft.read(press / "scene.toml")
    draft.set_kind("single_view", (96, 240))
    assert draft.values()["views"] == {"camera": {"rows": [0, 96], "columns": [0, 240]}}
    assert tomllib.loads(draft.text)["kind"] == "single_view"
    draft.set_kind("press", (96, 240))
    assert set(draft.values()["views"]) == {"contact", "topography"}
    with pytest.raises(FingerflowError, match="it should be one of press"):
        draft.set_kind("pres", (96, 240))


def test_the_scene_of_a_result_is_the_one_it_was_computed_from(processed: Path) -> None:
    scene = load_scene(processed / "scene.toml")
    again = scene_of_settings(scene.as_json())
    assert again.as_json() == scene.as_json()
    assert dict(again.views) == dict(scene.views)


def test_what_a_path_is(press: Path, processed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    draft, result = open_path(processed / "scene.toml")
    assert draft is not None
    assert result == processed / "result.h5"
    draft, result = open_path(press / "scene.toml")
    assert draft is not None
    assert result is None
    draft, result = open_path(processed / "result.h5")
    assert draft is not None
    assert draft.path == processed / "scene.toml"
    assert open_path(press / "frames.npy")[1] is None
    monkeypatch.chdir(press)
    draft, _ = open_path(None)
    assert draft is not None
    assert draft.path == press / "scene.toml"
    for wrong in ("nothing.toml", "forces.csv"):
        with pytest.raises(FingerflowError, match=wrong):
            open_path(press / wrong)
    monkeypatch.chdir(press.parent)
    with pytest.raises(FingerflowError, match=r"no scene\.toml"):
        open_path(None)


def test_a_key_is_written_where_its_commented_line_stands(press: Path) -> None:
    draft = Draft.create(open_recording(press / "frames.npy"))
    draft.set(("forces", "file"), "f.csv")
    draft.set(("forces", "sign"), [-1, 1, 1])
    draft.set(("calibration", "mm_per_px"), 0.03)
    headings = re.split(r"^\[", draft.text, flags=re.MULTILINE)
    forces, calibration = (
        next(part for part in headings if part.startswith(name)) for name in ("forces", "calibration")
    )
    assert draft.text.count("[forces]") == 1
    assert re.search(r'^file = "f.csv" .*# CSV', forces, re.MULTILINE)
    assert re.search(r"^sign = \[-1, 1, 1\] .*# -1 where", forces, re.MULTILINE)
    assert re.search(r"^mm_per_px = 0.03 .*# of the contact", calibration, re.MULTILINE)
