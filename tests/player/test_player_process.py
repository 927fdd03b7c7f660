"""The player as a program of its own: without torch, killed, and started by the package's command line."""

import os
import shutil
import signal
import subprocess
import sys
import time
import venv
from importlib.metadata import files
from pathlib import Path

import numpy as np
import pytest
from conftest import Stream
from tiny_bundle import POINTS

from fingerflow import player

# What numpy and onnxruntime need at run time; nothing else of this installation is seen by the player.
NEEDED = ("numpy", "onnxruntime", "flatbuffers", "protobuf", "packaging")


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Python of an environment that has numpy and onnxruntime only."""
    home = tmp_path_factory.mktemp("lab") / "env"
    venv.EnvBuilder(symlinks=sys.platform != "win32").create(home)
    folder = home / ("Scripts" if sys.platform == "win32" else "bin")
    packages = Path(
        subprocess.check_output(
            [folder / "python", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], text=True
        ).strip()
    )
    for distribution in NEEDED:
        for top in {path.parts[0] for path in files(distribution) or () if path.parts[0] not in ("..", "__pycache__")}:
            found = next(Path(place, top) for place in sys.path if Path(place, top).exists())
            try:
                (packages / top).symlink_to(found, found.is_dir())
            except (OSError, NotImplementedError):  # Windows without the right to make links
                shutil.copytree(found, packages / top) if found.is_dir() else shutil.copy(found, packages / top)
    return folder / "python"


def _command(python: Path, stream: Stream, *arguments: str) -> tuple[list[str], dict[str, str]]:
    """The player of the bundle's folder, as a technician starts it."""
    shutil.copytree(Path(player.__file__).parent, stream.bundle / "player")
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    options = ["--output", str(stream.folder / "results"), "--page", "off", "--threads", "1", "--no-spin"]
    return [str(python), "-m", "player", *options, *arguments], environment


def test_there_is_no_torch(python: Path) -> None:
    command = [python, "-c", "import numpy, onnxruntime, sys; sys.exit(7 if 'torch' in sys.modules else 0)"]
    assert subprocess.run(command, check=False, cwd=python.parent).returncode == 0
    command = [python, "-c", "import torch"]
    assert subprocess.run(command, check=False, cwd=python.parent, capture_output=True).returncode == 1


def test_a_killed_stream_leaves_whole_results(python: Path, stream: Stream) -> None:
    command, environment = _command(
        python, stream, "--source", "synthetic", "--rate", "100"
    )  # which a machine that has other work keeps up with
    with subprocess.Popen(command, env=environment, cwd=stream.bundle, stderr=subprocess.PIPE, text=True) as running:
        path = stream.folder / "results" / "records.bin"
        deadline = time.monotonic() + 60
        while not (path.exists() and path.stat().st_size):
            assert running.poll() is None, running.communicate()[1]
            assert time.monotonic() < deadline
            time.sleep(0.02)
        time.sleep(1.3)  # at least one second more is on the disk now
        running.kill()
        running.communicate()
    records, header, events = player.read_results(stream.folder / "results")
    assert len(records) >= 100
    np.testing.assert_array_equal(records["frame"], np.arange(len(records)))
    assert np.isfinite(records["position_px"]).all()
    np.testing.assert_allclose(np.diff(records["time"]), 1 / 100, rtol=1e-6)
    assert (header["source"], events[0]["points"]) == ("synthetic", POINTS)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
def test_an_interrupt_ends_it_cleanly(python: Path, stream: Stream) -> None:
    command, environment = _command(python, stream, "--source", "synthetic", "--rate", "300")
    with subprocess.Popen(command, env=environment, cwd=stream.bundle, stderr=subprocess.PIPE, text=True) as running:
        deadline = time.monotonic() + 60
        while not (stream.folder / "results" / "records.bin").exists():
            assert running.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.02)
        time.sleep(0.3)
        running.send_signal(signal.SIGINT)
        _, said = running.communicate(timeout=60)
    assert running.returncode == 130, said
    assert "Traceback" not in said
    records = player.read_results(stream.folder / "results").records
    np.testing.assert_array_equal(records["frame"], np.arange(len(records)))
    assert len(records)


def test_a_bundle_is_imported_as_it_is_played(python: Path, stream: Stream) -> None:
    """As its README has it: results by name, from the folder of the bundle, without the package."""
    command, environment = _command(python, stream, "--source", "synthetic", "--frames", "20")
    subprocess.run(command, env=environment, cwd=stream.bundle, check=True, capture_output=True)
    results, table = stream.folder / "results", stream.folder / "table.csv"
    code = f"""
import sys, player
records, header, events = player.read_results({str(results)!r})
assert records["position_px"].shape == (20, {POINTS}, 2)
player.write_table({str(results)!r}, {str(table)!r})
try:
    player.read_results(".")
except player.PlayerError as error:
    assert "is no results folder" in str(error)
assert not [name for name in sys.modules if name.startswith("fingerflow")]
"""
    subprocess.run([str(python), "-c", code], env=environment, cwd=stream.bundle, check=True)
    assert len(table.read_text().splitlines()) == 21


def test_the_command_line_of_the_package_is_the_same_player(stream: Stream) -> None:
    """`fingerflow stream`, which imports no torch either, and `fingerflow export-table` of its results."""
    code = "import sys; from fingerflow.cli import main\ntry: main()\nfinally: assert 'torch' not in sys.modules"
    options = ["--source", "synthetic", "--frames", "20", "--output", "results", "--page", "off"]
    for arguments in (
        ["stream", str(stream.bundle), *options],
        ["export-table", "results", "table.csv"],
    ):
        ended = subprocess.run(
            [sys.executable, "-c", code, *arguments], cwd=stream.folder, capture_output=True, text=True
        )
        assert ended.returncode == 0, ended.stderr
    assert len((stream.folder / "table.csv").read_text().splitlines()) == 21
