"""Tests of the player as a process of its own: without torch, killed, interrupted, and started by `fingerflow
stream`.
"""

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from tiny_bundle import POINTS, Stream, write_bundle

from bench.bare_environment import ONNX, make_environment, variables
from fingerflow import player
from fingerflow.export.carried_modules import carry_modules


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the Python of an environment that has only numpy and onnxruntime."""
    return make_environment(tmp_path_factory.mktemp("lab") / "env", ONNX)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGKILL, marks=pytest.mark.long)])
def test_a_player_that_is_ended_leaves_whole_results(python: Path, stream: Stream, number: signal.Signals) -> None:
    """The player in the bundle's folder, without torch, ends cleanly after Ctrl-C; one that is killed has the records
    up to a second before.
    """
    carry_modules(stream.folder / "whole")
    stream.bundle = write_bundle(stream.folder / "whole")
    options = ["--output", str(stream.folder / "results"), "--page", "off", "--threads", "1"]
    command = [str(python), "-m", "fingerflow.player", *options, "--source", "synthetic", "--rate", "100"]
    process = subprocess.Popen(command, env=variables(), cwd=stream.bundle, stderr=subprocess.PIPE, text=True)
    with process as running:
        assert running.stderr is not None
        logged = (re.search(r"processed (\d+)", line) for line in running.stderr)
        least = next(int(said[1]) for said in logged if said and said[1] != "0")
        time.sleep(1.3 if number == signal.SIGKILL else 0)
        running.send_signal(number)
        _, said = running.communicate(timeout=60)
    assert running.returncode == (130 if number == signal.SIGINT else -number), said
    assert "Traceback" not in said
    records, header, events = player.read_results(stream.folder / "results")
    assert len(records) >= least
    np.testing.assert_array_equal(records["frame"], np.arange(len(records)))
    np.testing.assert_allclose(np.diff(records["time"]), 1 / 100, rtol=1e-6)
    assert (header["source"], events[0]["points"]) == ("synthetic", POINTS)


@pytest.mark.long
def test_the_command_line_of_the_package_is_the_same_player(stream: Stream) -> None:
    """`fingerflow stream` and `fingerflow export-table` of its results run without importing torch."""
    code = "import sys; from fingerflow.cli import main\ntry: main()\nfinally: assert 'torch' not in sys.modules"
    options = ["--source", "synthetic", "--frames", "20", "--output", "results", "--page", "off"]
    for arguments in (["stream", str(stream.bundle), *options], ["export-table", "results", "table.csv"]):
        ended = subprocess.run(
            [sys.executable, "-c", code, *arguments], cwd=stream.folder, capture_output=True, text=True
        )
        assert ended.returncode == 0, ended.stderr
    assert len((stream.folder / "table.csv").read_text().splitlines()) == 21
