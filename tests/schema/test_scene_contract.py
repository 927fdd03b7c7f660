"""Tests that `fingerflow process` and the player accept and refuse the same scenes with the same messages."""

from dataclasses import replace
from pathlib import Path

import pytest
from scene_cases import CALIBRATION, RIGHT, WRONG, WrongScene, write_folder

from fingerflow.errors import FingerflowError
from fingerflow.player import PlayerError
from fingerflow.player import stream_scene as player
from fingerflow.schema import scene as package
from fingerflow.schema.keys import SceneKey, SceneTable
from fingerflow.schema.scene_tables import SCENE


def said_by_both(path: Path) -> tuple[str, str]:
    with pytest.raises(FingerflowError) as ours:
        package.load_scene(path)
    with pytest.raises(PlayerError) as theirs:
        player.load_scene(path)
    return str(ours.value), str(theirs.value)


TOPOGRAPHY = RIGHT[RIGHT.index("[views.topography]") : RIGHT.index("[background]")]


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the path of a scene file, in a folder with the files that RIGHT names."""
    return write_folder(tmp_path_factory.mktemp("scene"))


@pytest.mark.parametrize("case", WRONG, ids=lambda case: case.said[:60])
def test_a_wrong_scene_is_refused_by_both_in_the_same_words(case: WrongScene, path: Path) -> None:
    assert case.old in RIGHT
    text = RIGHT.replace(case.old, case.new, 1)
    path.write_text(text, encoding="utf-8")
    ours, theirs = said_by_both(path)
    assert ours == theirs
    line = next(number for number, line in enumerate(text.splitlines(), 1) if line.startswith(case.start))
    [first] = [one for one in ours.splitlines() if case.said in one]
    assert first.startswith(f"{path}, line {line}: "), first
    if "it was made with" not in case.said:  # a calibration of other views may differ in both
        assert ours.count("\n") == 0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"[recording", "is not valid TOML: "),
        (b"# \xff", "is not UTF-8 text (invalid start byte); save it as UTF-8"),
        (None, "there is no such file (looked in "),
    ],
)
def test_no_scene_file_at_all(text: bytes | None, said: str, path: Path) -> None:
    path = path.with_name("other.toml")
    path.unlink(missing_ok=True)
    if text is not None:
        path.write_bytes(text)
    ours, theirs = said_by_both(path)
    assert ours == theirs
    assert f"{path}: {said}" in ours


def test_what_is_right_is_read_alike(path: Path) -> None:
    text = RIGHT.replace('"reference_frame"', "0.25")
    path.write_text(f'\ufeffkind = "slip"\n{text}', encoding="utf-8")
    ours, theirs = package.load_scene(path), player.load_scene(path)
    assert (ours.kind, ours.contact.threshold) == ("slip", 0.25)
    assert ours == theirs
    assert ours.given == theirs.given


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('frames = "frames.npy"', 'frames = "away.npy"', "recording.frames is 'away.npy'"),
        ('frames = "frames.npy"\n', "", "recording.frames is missing"),
        ('frames = "empty.npy"', 'frames = "away.npy"', "background.frames is 'away.npy'"),
        ('[background]\nframes = "empty.npy"\ndark = "dark.npy"\n', "", "background is missing"),
        ('file = "forces.csv"', 'file = "away.csv"', "forces.file is 'away.csv'"),
    ],
)
def test_what_a_stream_may_do_without(old: str, new: str, said: str, path: Path) -> None:
    assert old in RIGHT
    path.write_text(RIGHT.replace(old, new, 1), encoding="utf-8")
    player.load_scene(path)
    with pytest.raises(FingerflowError, match=said):
        package.load_scene(path)


def test_a_calibration_file_gives_scale_and_transform(path: Path) -> None:
    """A file of the scale alone does only where there is no second view."""
    direct = package.load_scene(write(path, RIGHT)).calibration
    found = package.load_scene(write(path, RIGHT.replace(CALIBRATION, 'file = "rig.toml"')))
    assert found.calibration == replace(direct, file=path.with_name("rig.toml"))
    assert "calibration.mm_per_px" in found.given
    alone = RIGHT.replace(CALIBRATION, 'file = "ring_alone.toml"').replace(TOPOGRAPHY, "")
    assert package.load_scene(write(path, alone)).calibration.mm_per_px == direct.mm_per_px


def test_what_a_stream_needs_besides(path: Path) -> None:
    """A stream needs both views, whatever the kind, as the graphs of a bundle take both."""
    path.write_text(RIGHT.replace(TOPOGRAPHY, ""), encoding="utf-8")
    assert package.load_scene(path).views.keys() == {"contact"}
    with pytest.raises(PlayerError, match=r"views.topography is missing; add it"):
        player.load_scene(path)


def test_defaults_are_values_that_may_be_given() -> None:

    for table in SCENE.values():
        assert isinstance(table, SceneTable)
        for name, key in table.keys.items():
            if isinstance(key, SceneKey) and key.default is not None:
                given = [list(row) for row in key.default] if isinstance(key.default, tuple) else key.default
                assert key.type.convert(given) == key.default, name
