"""Tests of the modules that a bundle carries: those that the player needs, unchanged, and none that needs torch."""

import subprocess
import sys
import tomllib
from importlib import resources
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from fingerflow.export import carried_modules
from fingerflow.export.write_bundle import scene_for
from fingerflow.recordings import open_recording
from tests.fuzz.samples import samples

_IN_A_BUNDLE = """
import sys
from pathlib import Path

import numpy as np

absent = {name: None for name in ("torch", "scipy", "h5py", "cv2", *sys.argv[3:])}
sys.modules.update(absent)
from fingerflow.errors import FingerflowError
from fingerflow.player.sources import open_source

try:
    source = open_source(Path(sys.argv[1]), None, "uint8", 1)
    frames = []
    while (frame := source.read()) is not None:
        frames.append(frame)
    source.close()
except FingerflowError as error:
    sys.exit(f"said: {error}")
np.save(sys.argv[2], np.array(frames))
loaded = {Path(module.__file__) for name, module in sys.modules.items() if name.startswith("fingerflow")}
assert all(file.is_relative_to(Path.cwd()) for file in loaded), loaded
"""


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bundle")
    carried_modules.carry_modules(folder)
    return folder


def _play(bundle: Path, file: Path, *absent: str) -> subprocess.CompletedProcess[str]:
    """Play a recording as the bundle does, and save its frames as played.npy beside it; return the ended process."""
    command = [sys.executable, "-c", _IN_A_BUNDLE, str(file), str(file.with_name("played.npy")), *absent]
    return subprocess.run(command, cwd=bundle, capture_output=True, text=True)


def _sample(kind: str, folder: Path, chosen: int = 0) -> Path:
    """Write a sample of a format; return the path of the file to open."""
    (folder / "made").mkdir()
    sample = samples(kind, folder / "made")[chosen]
    for name, data in sample.files.items():
        (folder / name).write_bytes(data)
    return folder / sample.opened


@pytest.mark.parametrize(("kind", "chosen"), [("cine", 0), ("mraw", 0), ("npy", 1), ("tiff", 0)])
def test_a_bundle_reads_what_the_package_reads(kind: str, chosen: int, bundle: Path, tmp_path: Path) -> None:
    """A bundle reads the frames of a recording from the second one on, bit for bit as the package reads them."""
    file = _sample(kind, tmp_path, chosen)
    ended = _play(bundle, file)
    assert ended.returncode == 0, ended.stderr
    with open_recording(file) as recording:
        expected = recording.read()[1:]
    played = np.load(tmp_path / "played.npy")
    assert len(expected)
    assert played.dtype == expected.dtype
    np.testing.assert_array_equal(played, expected)


def test_a_library_that_is_not_there_is_named(bundle: Path, tmp_path: Path) -> None:
    ended = _play(bundle, _sample("tiff", tmp_path), "tifffile")
    assert "its format needs the library tifffile: `pip install tifffile`" in ended.stderr


def test_files_are_carried_as_they_are(bundle: Path) -> None:
    home = bundle / "fingerflow"
    files = {file.relative_to(home) for file in home.rglob("*") if file.is_file() and file.suffix != ".pyc"}
    library = {file for file in files if file.name.startswith("_kernels")}
    assert bool(library) == (find_spec("fingerflow._kernels") is not None)
    assert {str(file) for file in files - library if file.suffix != ".py"} >= {
        f"player/page/{name}" for name in ("index.html", "page.css", "page.js")
    }
    for file in files - library:
        assert (home / file).read_bytes() == (carried_modules.PACKAGE / file).read_bytes()


def test_the_whole_player_is_carried_and_nothing_that_needs_torch() -> None:
    package, carried = carried_modules.PACKAGE, carried_modules.modules_to_carry()
    files = [file for room in ("player", "engines", "tracker", "schema") for file in (package / room).rglob("*.py")]
    of_streams = [file for file in files if file.parent != package / "tracker" / "recorded"]
    left_out = {str(file.relative_to(package)) for file in of_streams if file not in carried.values()}
    assert left_out == {"engines/torch.py"}, f"they need more to load than {carried_modules.ON_THE_LAB_PC}"
    assert "fingerflow.kernels.tensors" not in carried


def test_every_carried_module_finds_what_it_loads(bundle: Path) -> None:
    """Every carried module can be imported from the files of the bundle, with NumPy, onnxruntime and tifffile only."""
    code = """
import sys
from importlib import import_module
from pathlib import Path
sys.modules.update({name: None for name in ("torch", "scipy", "h5py", "cv2", "av", "psutil")})
for name in sys.argv[1:]:
    assert Path(import_module(name).__file__).is_relative_to(Path.cwd()), name
"""
    command = [sys.executable, "-c", code, *carried_modules.modules_to_carry()]
    ended = subprocess.run(command, cwd=bundle, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr


def test_a_bundle_without_the_library_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(carried_modules, "find_spec", lambda name: None)
    carried_modules.carry_modules(tmp_path / "bundle")
    assert not list((tmp_path / "bundle" / "fingerflow").glob("_kernels*"))
    assert "no compiled library" in caplog.text


def test_the_scene_to_fill_in_has_views_of_the_size_of_the_bundle() -> None:
    template = (resources.files("fingerflow.export") / "template" / "scene.toml").read_text(encoding="utf-8")
    assert scene_for(template, 512, 640).count("[640, 1280]") == 1  # the columns of the template itself
    views = tomllib.loads(scene_for(template, 192, 240))["views"]
    assert views["contact"] == {"rows": [0, 192], "columns": [240, 480]}
    assert views["topography"] == {"rows": [0, 192], "columns": [0, 240]}
