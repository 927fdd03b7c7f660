"""Scene files: what is right is read, what is wrong is named with its line."""

from pathlib import Path

import numpy as np
import pytest

from fingerflow.errors import FingerflowError
from fingerflow.scene import load_scene, scene_text


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("frames.npy", "empty.npy", "forces.csv"):
        (tmp_path / name).write_bytes(b"")
    return tmp_path


def write(folder: Path, old: str = "", new: str = "") -> Path:
    text = scene_text(
        frames="frames.npy", background="empty.npy", forces="forces.csv", calibration="mm_per_px = 0.0325"
    )
    assert old in text
    path = folder / "scene.toml"
    path.write_text(text.replace(old, new) if old else text, encoding="utf-8")
    return path


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
        ("points = 700", "points = 2", "greater than or equal to 3"),
        ("points = 700", 'points = "many"', "many"),
        ('frames = "frames.npy"', 'frames = "other.npy"', "does not exist"),
        ("mm_per_px = 0.0325", "mm_per_px = -1", "greater than 0"),
        ("mm_per_px = 0.0325", 'file = "none.toml"', "none.toml"),
        ("poisson_ratio = 0.4", "poisson_ratio = 0.5", "less than 0.5"),
        ("columns = [640, 1280]", "columns = [1280, 640]", "first < end"),
        ("trigger_level = 2.5", "", "trigger_level"),
    ],
)
def test_a_wrong_value_is_named_with_file_and_line(folder: Path, old: str, new: str, said: str) -> None:
    path = write(folder, old, new)
    with pytest.raises(FingerflowError, match=said) as caught:
        load_scene(path)
    assert f"{path}, line " in str(caught.value)


def test_line_of_a_key(folder: Path) -> None:
    path = write(folder, "points = 700", "points = 1")
    number = next(n for n, line in enumerate(path.read_text().splitlines(), 1) if line.startswith("points"))
    with pytest.raises(FingerflowError, match=f"line {number}: tracking.points is 1"):
        load_scene(path)


def test_missing_file_and_broken_toml(folder: Path) -> None:
    with pytest.raises(FingerflowError, match="fingerflow init"):
        load_scene(folder / "nothing.toml")
    (folder / "broken.toml").write_text("[recording")
    with pytest.raises(FingerflowError, match="not valid TOML"):
        load_scene(folder / "broken.toml")
