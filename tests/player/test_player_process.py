"""Tests of the player as a process of its own: without torch, killed, interrupted, and started by `fingerflow
stream`.
"""

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import Stream
from tiny_bundle import POINTS

from bench.bare_environment import ONNX, make_environment, variables
from fingerflow import player
from fingerflow.export.carried_modules import carry_modules


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the Python of an environment that has only numpy and onnxruntime."""
    return make_environment(tmp_path_factory.mktemp("lab") / "env", ONNX)


def _command(python: Path, stream: Stream, *arguments: str) -> tuple[list[str], dict[str, str]]:
    """Return the command that starts the player of the bundle's folder, as a technician does, and its environment
    variables.
    """
    carry_modules(stream.bundle)
    options = ["--output", str(stream.folder / "results"), "--page", "off", "--threads", "1"]
    return [str(python), "-m", "fingerflow.player", *options, *arguments], variables()


@pytest.mark.long
def test_a_killed_stream_leaves_whole_results(python: Path, stream: Stream) -> None:
    command, environment = _command(
        python, stream, "--source", "synthetic", "--rate", "100"
    )  # a rate that a busy machine keeps up with
    with subprocess.Popen(command, env=environment, cwd=stream.bundle, stderr=subprocess.PIPE, text=True) as running:
        path = stream.folder / "results" / "records.bin"
        deadline = time.monotonic() + 60
        while not (path.exists() and path.stat().st_size):
            assert running.poll() is None, running.communicate()[1]
            assert time.monotonic() < deadline
            time.sleep(0.02)
        time.sleep(1.3)  # records of at least one more second are on the disk now
        running.kill()
        running.communicate()
    records, header, events = player.read_results(stream.folder / "results")
    assert len(records) >= 100
    np.testing.assert_array_equal(records["frame"], np.arange(len(records)))
    assert np.isfinite(records["position_px"]).mean() > 0.9
    np.testing.assert_allclose(np.diff(records["time"]), 1 / 100, rtol=1e-6)
    assert (header["source"], events[0]["points"]) == ("synthetic", POINTS)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
def test_an_interrupt_ends_the_player_cleanly(python: Path, stream: Stream) -> None:
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


@pytest.mark.long
def test_the_command_line_of_the_package_is_the_same_player(stream: Stream) -> None:
    """`fingerflow stream` and `fingerflow export-table` of its results run without importing torch."""
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
