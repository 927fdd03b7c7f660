"""Tests of scene files: valid files are read, errors are named with their line."""

import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fingerflow.calibration import Calibration, Disc, Transform
from fingerflow.errors import FingerflowError
from fingerflow.schema.scene import load_scene
from fingerflow.schema.scene_template import scene_text
from fingerflow.schema.views import View

MATRIX = [[1.01, -0.01, 3.4], [0.01, 1.01, -6.2]]
VIEWS = {"topography": View((0, 512), (0, 640)), "contact": View((0, 512), (640, 1280))}
FILE, QUOTED = 'file = "calibration.toml"', '"points"'
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


def write_calibration(path: Path, views: dict[str, View], matrix: list[list[float]] | None) -> None:
    hole = Disc((100.0, 90.0), (80.0, 79.0), 0.3, 0.1, 0.5, 1.0, 0.4, 30.0)
    transform = None if matrix is None else Transform(np.array(matrix), np.zeros((3, 2)))
    found = Calibration(0.0325, 2.75, hole, views, affine=transform, similarity=transform)
    path.write_text(found.to_toml(), encoding="utf-8")


def message_of(path: Path) -> str:
    with pytest.raises(FingerflowError) as caught:
        load_scene(path)
    return str(caught.value)


def line_of(path: Path, start: str) -> int:
    return next(n for n, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1) if line.startswith(start))


def test_template_is_a_scene(folder: Path) -> None:
    scene = load_scene(write(folder))
    assert scene.recording.frames == folder.resolve() / "frames.npy"
    assert scene.views.topography is not None
    assert scene.views.contact.columns == (640, 1280)
    assert scene.tracking.window_px == 25
    assert np.asarray(scene.calibration.topography_to_contact).shape == (2, 3)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("median_px = 3", "median_pix = 3", "did you mean 'median_px'"),
        ("median_px = 3", "median_px = 8", "odd"),
        ("points = 700", "points = 2", "at least 3"),
        ("points = 700", 'points = "many"', "many"),
        ('frames = "frames.npy"', 'frames = "other.npy"', "does not exist"),
        ("mm_per_px = 0.0325", "mm_per_px = -1", "above 0"),
        ("mm_per_px = 0.0325", 'mm_per_px = "0.0325"', "should be a number"),
        ("points = 700", 'points = "700"', "'700': it should be a whole number"),
        ("points = 700", "points = true", "True: it should be a whole number"),
        ("points = 700", "points = 700.0", "700.0: it should be a whole number"),
        ("gauge_length_mm = 1.6", "gauge_length_mm = true", "True: it should be a number"),
        ("gauge_length_mm = 1.6", "gauge_length_mm = nan", "finite"),
        ("gain_offset = true", "gain_offset = 0", "0: it should be true or false"),
        ("rows = [0, 512]", "rows = [0, true]", "whole number"),
        ("rows = [0, 512]", "rows = [0, 5, 12]", "at most 2 items, not 3"),
        ("rows = [0, 512]", "rows = 512", "a list"),
        ('threshold = "reference_frame"', "threshold = 2", "'per_frame', or it should be below 1"),
        ("[fields]", "[[fields]]", "a table"),
        ("poisson_ratio = 0.4", "poisson_ratio = 0.5", "below 0.5"),
        ("columns = [640, 1280]", "columns = [1280, 640]", "first < end"),
    ],
)
def test_a_wrong_value_is_named_with_file_and_line(folder: Path, old: str, new: str, said: str) -> None:
    path = write(folder, old, new)
    with pytest.raises(FingerflowError, match=said) as caught:
        load_scene(path)
    assert f"{path}, line " in str(caught.value)


def test_whole_numbers_are_numbers(folder: Path) -> None:
    assert load_scene(write(folder, "gauge_length_mm = 1.6", "gauge_length_mm = 2")).fields.gauge_length_mm == 2.0


@pytest.mark.parametrize(
    ("old", "new", "start", "said"),
    [
        ("points = 700", "points = 1", "points", "tracking.points is 1: it should be at least 3"),
        (
            "columns = [640, 1280]",
            "columns = [-1, 1280]",
            "columns = [-1",
            "views.contact.columns is .*0 <= first < end",
        ),
        (
            "# last_frame = 299",
            "first_frame = 20\nlast_frame = 3",
            "last_frame",
            "recording.last_frame is 3: that is before first_frame, 20.*give at least 20",
        ),
        ("trigger_level = 2.5", "", "trigger", "forces.trigger is 'trigger': .* belong together.*add trigger_level"),
        ('trigger = "trigger"', "", "trigger_level", "forces.trigger_level is 2.5: .*add trigger ="),
        (
            f"topography_to_contact = {MATRIX}",
            "topography_to_contact = [[1, 2, 3], [2, 4, 0]]",
            "topography_to_contact",
            "calibration.topography_to_contact is .*must be invertible",
        ),
        ("mm_per_px = 0.0325", 'mm_per_px = 1\nfile = "c.toml"', 'file = "c', "mm_per_px, .*exclude each other"),
        (f"mm_per_px = 0.0325\ntopography_to_contact = {MATRIX}", "file = 3", "file = 3", "is 3: that is no path"),
        (
            f"topography_to_contact = {MATRIX}",
            "",
            "mm_per_px",
            "calibration.mm_per_px is 0.0325: .*add topography_to_contact",
        ),
        ("[fields]", "[[fields]]", "[[fields]]", "fields is .*: it should be a table"),
        ("[tracking]", "[tracking]\n[tracking.gpu]", "[tracking.gpu]", "tracking.gpu is not a key"),
    ],
)
def test_the_line_is_that_of_the_key(folder: Path, old: str, new: str, start: str, said: str) -> None:
    path = write(folder, old, new)
    message = message_of(path)
    assert message.startswith(f"{path}, line {line_of(path, start)}: ")
    assert re.search(said, message), message
    assert "\n" not in message


def test_keys_in_other_spellings_have_their_line(folder: Path) -> None:
    """Errors in inline tables, dotted and quoted keys, which are the same TOML, name their line."""
    inline = write(folder, "[tracking]\npoints = 700\n", '[tracking]\n"points"= 1\n')
    assert f"line {line_of(inline, QUOTED)}: tracking.points is 1" in message_of(inline)
    text = "fields = { gauge_length_mm = -1 }\n" + write(folder).read_text().split("[fields]")[0]
    inline.write_text(text)
    assert "line 1: fields.gauge_length_mm is -1" in message_of(inline)
    inline.write_text("\n\nfields.gauge_length_mm = -1\n" + text.partition("\n")[2])
    assert "line 3: fields.gauge_length_mm is -1" in message_of(inline)


def test_a_misspelt_key_is_reported_once(folder: Path) -> None:
    for old, new, right in (
        ('frames = "frames.npy"', 'frame = "frames.npy"', "'frames'"),
        ("mm_per_px = 0.0325", "mm_per_pixel = 0.0325", "'mm_per_px'"),
        ("[background]", "[backgrund]", "'background'"),
    ):
        message = message_of(write(folder, old, new))
        assert f"did you mean {right}" in message
        assert len(message.splitlines()) == 1, message


def test_a_missing_key_is_reported(folder: Path) -> None:
    path = write(folder, 'frames = "frames.npy"', "")
    assert f"line {line_of(path, '[recording]')}: recording.frames is missing; add it" in message_of(path)
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


def test_a_calibration_file_gives_scale_and_transform(folder: Path) -> None:
    write_calibration(folder / "calibration.toml", VIEWS, MATRIX)
    scene = load_scene(write(folder, calibration=FILE))
    assert scene.calibration.mm_per_px == 0.0325
    np.testing.assert_array_equal(scene.calibration.topography_to_contact, MATRIX)
    assert scene.calibration.file == (folder / "calibration.toml").resolve()


def test_a_scale_alone_is_no_calibration_of_two_views(folder: Path) -> None:
    """A calibration without a transform is refused for two views; the identity would be wrong by many pixels,
    unnoticed.
    """
    write_calibration(folder / "calibration.toml", {"contact": VIEWS["contact"]}, None)
    path = write(folder, calibration=FILE)
    message = message_of(path)
    assert f"line {line_of(path, FILE)}: calibration.file is 'calibration.toml'" in message
    assert "the scale alone" in message
    assert "--target" in message
    alone = load_scene(write(folder, TOPOGRAPHY_TABLE, "", calibration=FILE))
    assert alone.views.topography is None
    assert alone.calibration.mm_per_px == 0.0325


def test_a_calibration_of_other_views_is_refused(folder: Path) -> None:
    write_calibration(folder / "calibration.toml", VIEWS, MATRIX)
    for old, new, name in (
        ("columns = [640, 1280]", "columns = [650, 1280]", "contact"),
        ("columns = [0, 640]", "columns = [0, 600]", "topography"),
    ):
        path = write(folder, old, new, calibration=FILE)
        message = message_of(path)
        assert f"line {line_of(path, FILE)}: calibration.file is 'calibration.toml'" in message
        assert f"made with the {name} view rows [0, 512], {old.replace(' =', '')}" in message
        assert f"the scene has rows [0, 512], {new.replace(' =', '')}" in message
        assert "fingerflow calibrate --topography 0 512 0" in message


def test_a_region_beyond_its_view_is_refused(folder: Path) -> None:
    assert load_scene(write(folder, region=View((0, 512), (0, 640)))).stream.region is not None
    for region in (View((0, 513), (0, 640)), View((0, 512), (0, 641))):
        assert "ends beyond the topography view of 512 x 640 px" in message_of(write(folder, region=region))


def test_a_broken_calibration_file_is_named(folder: Path) -> None:
    (folder / "calibration.toml").write_text("mm_per_px = 0\n")
    message = message_of(write(folder, calibration=FILE))
    assert (
        "calibration.toml: this calibration has no entry 'hole'. Write it again with `fingerflow calibrate`" in message
    )


@pytest.mark.parametrize(
    "name", ["C:\\Users\\new\\table.cine", 'a "b" c.npy', "it's\ttab.npy", "名前 ü.npy", "del\x7f.npy", "a # b.npy"]
)
def test_paths_survive_the_template(name: str) -> None:
    values = tomllib.loads(scene_text(frames=name, background=name, dark=name, forces=name))
    assert values["recording"]["frames"] == values["background"]["frames"] == values["background"]["dark"] == name
    assert values["forces"]["file"] == name


@settings(max_examples=200)
@given(st.text(st.characters(exclude_categories=["Cs"]), min_size=1))
def test_any_path_survives_the_template(name: str) -> None:
    assert tomllib.loads(scene_text(frames=name))["recording"]["frames"] == name


def test_missing_file_and_broken_toml(folder: Path) -> None:
    with pytest.raises(FingerflowError, match="fingerflow init"):
        load_scene(folder / "nothing.toml")
    (folder / "broken.toml").write_text("[recording")
    with pytest.raises(FingerflowError, match="not valid TOML"):
        load_scene(folder / "broken.toml")


def test_a_scene_has_a_kind(folder: Path) -> None:
    """A scene is a press, or slip if it has a [slip] table, unless it states its kind."""
    assert load_scene(write(folder)).kind == "press"
    assert load_scene(write(folder, slip=True)).kind == "slip"
    assert load_scene(write(folder, "[recording]", 'kind = "slip"\n[recording]')).kind == "slip"
    assert load_scene(write(folder, "[recording]", 'kind = "press"\n[recording]', slip=True)).kind == "press"
    assert "kind is 'poke': it should be 'press', 'slip' or 'single_view'" in message_of(
        write(folder, "[recording]", 'kind = "poke"\n[recording]')
    )


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


def test_views_have_names(folder: Path) -> None:
    scene = load_scene(write(folder))
    assert scene.views.names() == ("contact", "topography")
    assert scene.views["contact"] == scene.views.contact
    bare = load_scene(write(folder, TOPOGRAPHY_TABLE, ""))
    assert bare.views.names() == ("contact",)
    with pytest.raises(KeyError, match="no view 'topography'; it has contact"):
        bare.views["topography"]
