"""What a bundle carries of the package: its readers, which give there what they give here, without the package."""

import ast
import subprocess
import sys
import tomllib
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from fingerflow.export.bundle import scene_for
from fingerflow.export.player_copy import READERS, copy_player
from fingerflow.recordings import open_recording
from tests.fuzz.samples import samples

_IN_A_BUNDLE = """
import sys
from pathlib import Path

import numpy as np

absent = {name: None for name in ("fingerflow", "torch", "scipy", "h5py", "cv2", *sys.argv[3:])}
sys.modules.update(absent)
from player.errors import PlayerError
from player.sources import open_recording

try:
    source = open_recording(Path(sys.argv[1]), None, "uint8", 1)
except PlayerError as error:
    sys.exit(f"said: {error}")
frames = []
while (frame := source.read()) is not None:
    frames.append(frame)
source.close()
np.save(sys.argv[2], np.array(frames))
assert not [name for name in sys.modules if name.startswith("fingerflow.")]
"""


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bundle")
    copy_player(folder)
    return folder


def _play(bundle: Path, file: Path, table: Path, *absent: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", _IN_A_BUNDLE, str(file), str(table), *absent]
    return subprocess.run(command, cwd=bundle, capture_output=True, text=True)


@pytest.mark.parametrize(("kind", "chosen"), [("cine", 0), ("cine", 1), ("mraw", 0), ("npy", 1), ("tiff", 0)])
def test_a_bundle_reads_what_the_package_reads(kind: str, chosen: int, bundle: Path, tmp_path: Path) -> None:
    """From the second frame on, bit for bit."""
    (tmp_path / "made").mkdir()
    sample = samples(kind, tmp_path / "made")[chosen]
    for name, data in sample.files.items():
        (tmp_path / name).write_bytes(data)
    file = tmp_path / sample.opened
    ended = _play(bundle, file, tmp_path / "played.npy")
    assert ended.returncode == 0, ended.stderr
    with open_recording(file) as recording:
        expected = recording.read()[1:]
    played = np.load(tmp_path / "played.npy")
    assert len(expected)
    assert played.dtype == expected.dtype
    np.testing.assert_array_equal(played, expected)


def test_a_library_that_is_not_there_is_named(bundle: Path, tmp_path: Path) -> None:
    (tmp_path / "made").mkdir()
    sample = samples("tiff", tmp_path / "made")[0]
    (tmp_path / "a.tif").write_bytes(next(iter(sample.files.values())))
    ended = _play(bundle, tmp_path / "a.tif", tmp_path / "played.npy", "tifffile")
    assert "its format needs the library tifffile: `pip install tifffile`" in ended.stderr


def test_damaged_files_end_in_a_sentence(bundle: Path, tmp_path: Path) -> None:
    (tmp_path / "a.cine").write_bytes(b"CI" + bytes(20))
    ended = _play(bundle, tmp_path / "a.cine", tmp_path / "played.npy")
    assert ended.stderr.startswith("said: ")
    assert "a.cine: not a Phantom recording" in ended.stderr
    assert "Traceback" not in ended.stderr


def test_the_copies_import_nothing_that_a_bundle_has_not(bundle: Path) -> None:
    home = bundle / "player" / "readers"
    assert {str(file.relative_to(home)) for file in home.rglob("*.py") if file.name != "__init__.py"} == set(READERS)
    for file in home.rglob("*.py"):
        allowed = {"numpy", "tifffile"} if file.name == "tiff.py" else {"numpy"}
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [one.name for one in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                top = name.partition(".")[0]
                assert (
                    top in allowed
                    or top in sys.stdlib_module_names
                    or (bundle / name.replace(".", "/")).with_suffix(".py").is_file()
                ), f"{file.name}: {name}"


def test_the_scene_to_fill_in_has_views_of_the_size_of_the_bundle() -> None:
    template = (resources.files("fingerflow") / "bundle" / "scene.toml").read_text(encoding="utf-8")
    assert scene_for(template, 512, 640).count("[640, 1280]") == 1  # what the template has
    views = tomllib.loads(scene_for(template, 192, 240))["views"]
    assert views["contact"] == {"rows": [0, 192], "columns": [240, 480]}
    assert views["topography"] == {"rows": [0, 192], "columns": [0, 240]}
