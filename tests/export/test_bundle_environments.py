"""Tests of a bundle on a lab PC with few packages: NumPy and onnxruntime, or NumPy alone."""

import json
import os
import re
import socket
import subprocess
import urllib.request
from pathlib import Path

import numpy as np
import pytest

from bench.bare_environment import variables
from fingerflow import open_stream, player
from tests import small_trials
from tests.export.lab_pc import ENGINES, LabPC, set_up

pytestmark = pytest.mark.long

FRAMES = 200


@pytest.fixture(scope="module", params=ENGINES)
def lab(request: pytest.FixtureRequest, bundle_of_trials: Path, tmp_path_factory: pytest.TempPathFactory) -> LabPC:
    return set_up(tmp_path_factory.mktemp("lab"), bundle_of_trials, request.param)


def test_player_page_and_results(lab: LabPC, tmp_path: Path) -> None:
    results, table = tmp_path / "results", tmp_path / "table.csv"
    command = [lab.python, "-m", "fingerflow.player", "--source", "synthetic", "--rate", "100", "--frames", str(FRAMES)]
    command += ["--threads", "1", "--output", results, "--page", "127.0.0.1:0", *lab.options]
    with subprocess.Popen(
        command, cwd=lab.bundle, env=variables(), stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
    ) as running:
        assert running.stderr is not None
        said = ""
        while not (page := re.search(r"live page: (http://[\d.:]+/)#token=(\S+)", said)):
            line = running.stderr.readline()
            assert line, said
            said += line
        with urllib.request.urlopen(page[1], timeout=30) as answer:
            assert b"<html" in answer.read()
        live = urllib.request.Request(f"{page[1]}live", headers={"X-Fingerflow": page[2]})
        with urllib.request.urlopen(live, timeout=30) as answer:
            assert len(answer.read()) > 8
        said += running.communicate(timeout=120)[1]
    assert running.returncode == 0, said

    ended = lab.run("-c", _READ, str(results), str(table))
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.split() == [str(FRAMES)] * 2
    assert len(table.read_text().splitlines()) == FRAMES + 1
    # The installed package reads the same results.
    stream = open_stream(results)
    assert stream.sizes["frame"] == FRAMES
    assert np.isfinite(stream["real_contact_area"]).any()


def test_live_numbers_need_no_other_package(lab: LabPC, tmp_path: Path) -> None:
    """UDP, OSC, serial lines and triggers need no other package; for ZeroMQ and LSL the package to install is named."""
    terminal, line = os.openpty()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(20)
        port = receiver.getsockname()[1]
        when = ("--when", "gross_contact_area > 3 mm2", "--then", f"serial:{os.ttyname(line)}:1")
        stream = ("-m", "fingerflow.player", "--source", "synthetic", "--frames", "60", "--page", "off", *lab.options)
        out = ("--output", str(tmp_path / "results"), "--send", f"udp:127.0.0.1:{port}", "--send", "osc:127.0.0.1:9")
        ended = lab.run(*stream, *out, *when)
        assert ended.returncode == 0, ended.stderr
        assert [json.loads(receiver.recv(4096))["frame"] for _ in range(60)] == list(range(60))
    assert os.read(terminal, 9) == b"1"  # the contact grows once in half a period
    os.close(terminal)
    os.close(line)
    for kind, package in (("zeromq:tcp://127.0.0.1:9", "pyzmq"), ("lsl:a", "pylsl")):
        ended = lab.run(*stream, "--output", str(tmp_path / "more"), "--send", kind)
        assert ended.returncode == 2
        assert f"`pip install {package}`" in ended.stderr


_READ = """
import sys
from pathlib import Path

from fingerflow import player
from fingerflow.errors import FingerflowError

results, table = sys.argv[1:]
records, header, events = player.read_results(results)
print(len(records), len(records["position_px"]))
player.write_table(results, table)
try:
    player.read_results(".")
except FingerflowError as error:
    assert "name the results folder" in str(error)
loaded = {Path(module.__file__) for name, module in sys.modules.items() if name.startswith("fingerflow")}
assert all(file.is_relative_to(Path.cwd() / "fingerflow") for file in loaded), loaded
"""


@pytest.mark.parametrize("name", ["process"])
def test_what_a_bundle_does_not_carry_is_said(name: str, lab: LabPC) -> None:
    ended = lab.run("-c", f"import fingerflow; fingerflow.{name}")
    assert f"ImportError: {name} is not in this copy of fingerflow, the one of a deployment bundle" in ended.stderr


# A camera wrapper as the README of a bundle has it: ten lines about the maker's software, here a file of frames.
_CAMERA = """
import itertools

import numpy as np


def make():
    numbers, frames = itertools.count(), np.load("trial/frames.npy")

    def next_frame():
        number = next(numbers)
        return (frames[number], 7 + number / 300) if number < len(frames) else None

    return next_frame
"""


def test_a_wrapper_of_ten_lines_is_a_camera(lab: LabPC, tmp_path: Path) -> None:
    """A camera gives the results of the recording that it plays, and the times of its stamps."""
    small_trials.write_trial(lab.bundle / "trial")
    (lab.bundle / "my_camera.py").write_text(_CAMERA)
    played = []
    for source in (("--source", "trial/frames.npy"), ("--camera", "my_camera:make", "--policy", "every")):
        output = tmp_path / source[0].strip("-")
        ended = lab.play(output, *source, "--scene", "trial/scene.toml")
        assert ended.returncode == 0, ended.stderr
        played.append(player.read_results(output).records)
    recorded, records = played
    assert len(records) == small_trials.FRAMES
    for name in ("real_contact_area", "gross_contact_area", "position_px", "frame_status"):
        np.testing.assert_array_equal(records[name], recorded[name], err_msg=name)
    # Fields are rounded by float32 as frames are measured at once, which depends on how many wait.
    np.testing.assert_allclose(records["divergence"], recorded["divergence"], rtol=2e-5, atol=1e-6)
    np.testing.assert_allclose(records["time"], np.arange(small_trials.FRAMES) / 300, atol=1e-9)


def test_the_benchmark_heeds_the_engine(lab: LabPC) -> None:
    short = "cli.benchmark.__defaults__ = None, 0.1, 0.1"  # s, where a lab waits for ten
    code = f"import sys; from fingerflow.player import cli; {short}; sys.exit(cli.main())"
    ended = lab.run("-c", code, "--benchmark", *lab.options, "--threads", "1")
    assert ended.returncode == 0, ended.stderr
    first, *_, last = ended.stdout.splitlines()
    assert f", computed by {lab.options[1]}" in first
    assert last.startswith("This PC holds ")
