"""Tests of cameras, force sensors, outputs and the benchmark on a lab PC that has NumPy and onnxruntime, or NumPy
alone, and beside them the one package that an output or a camera needs.
"""

import json
import os
import subprocess
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fingerflow import player
from tests.export.lab_pc import ENGINES, LabPC, set_up
from tests.small_trials import FRAMES, write_trial

pytestmark = pytest.mark.long

Records = np.ndarray[Any, Any]
SEEN = ("real_contact_area", "gross_contact_area", "position_px", "divergence", "frame_status")

# A camera wrapper as the README of a bundle has it: ten lines about the maker's software, here a file of frames.
CAMERA = """
import itertools
import time
from pathlib import Path

import numpy as np


def make():
    numbers, frames = itertools.count(), np.load("trial/frames.npy")

    def next_frame():
        number = next(numbers)
        while not Path("go").exists():  # receivers connect to the player first
            time.sleep(0.02)
        time.sleep(0.02)
        return (frames[number], 7 + number / 300) if number < len(frames) else None

    return next_frame
"""
SENSOR = """
import time


def make():
    def read():
        time.sleep(0.002)
        return 1.5, -0.5

    return read


def take(frame, values):
    with open("taken.txt", "a") as file:
        file.write(f"{frame.number} {values['normal_force']}\\n")
"""


@pytest.fixture(scope="module", params=ENGINES)
def live(request: pytest.FixtureRequest, bundle_of_trials: Path, tmp_path_factory: pytest.TempPathFactory) -> LabPC:
    """Return a lab PC with the recording of a press, a camera wrapper and a sensor."""
    lab = set_up(tmp_path_factory.mktemp("lab"), bundle_of_trials, request.param)
    write_trial(lab.bundle / "trial")
    (lab.bundle / "my_camera.py").write_text(CAMERA)
    (lab.bundle / "my_sensor.py").write_text(SENSOR)
    (lab.bundle / "go").touch()
    return lab


@pytest.fixture(scope="module")
def of_file(live: LabPC, tmp_path_factory: pytest.TempPathFactory) -> Records:
    """Return the records of the recording, played as a file."""
    output = tmp_path_factory.mktemp("file") / "results"
    return _records(live.play(output, "--source", "trial/frames.npy", "--scene", "trial/scene.toml"), output)


def _records(ended: subprocess.CompletedProcess[str], output: Path) -> Records:
    assert ended.returncode == 0, ended.stderr
    records: Records = player.read_results(output).records
    assert len(records) == FRAMES
    return records


def _camera(camera: str, *more: str) -> tuple[str, ...]:
    return ("--camera", camera, "--scene", "trial/scene.toml", "--policy", "every", "--frames", str(FRAMES), *more)


def test_a_wrapper_of_ten_lines_is_a_camera(live: LabPC, of_file: Records, tmp_path: Path) -> None:
    """A camera gives the results of the recording that it plays, and the times of its stamps."""
    records = _records(live.play(tmp_path / "out", *_camera("my_camera:make")), tmp_path / "out")
    for name in SEEN:
        np.testing.assert_array_equal(records[name], of_file[name], err_msg=name)
    np.testing.assert_allclose(records["time"], np.arange(FRAMES) / 300, atol=1e-9)


def test_zeromq_and_lsl_reach_their_receivers(live: LabPC, tmp_path: Path) -> None:
    """A ZeroMQ socket and an inlet of the Lab Streaming Layer receive every message that counts as sent, with the
    values of the records.
    """
    zmq = pytest.importorskip("zmq", reason="the package pyzmq is not installed")
    lsl = pytest.importorskip("pylsl", reason="the package pylsl is not installed")
    live.install("pyzmq", "pylsl")
    name, by_lsl, labels = f"bundle-{os.getpid()}", list[list[float]](), list[str]()
    by_zeromq = list[dict[str, Any]]()
    go, ended_all = live.bundle / "go", threading.Event()
    go.unlink()

    def receive() -> None:
        inlet = lsl.StreamInlet(lsl.resolve_byprop("name", name, timeout=60)[0])
        labels.extend(inlet.info().get_channel_labels())
        inlet.open_stream(60)
        go.touch()
        while (found := inlet.pull_sample(timeout=1))[0] is not None or not ended_all.is_set():
            if found[0] is not None:
                by_lsl.append(found[0])

    def pull_all() -> None:
        while pull.poll(1000) or not ended_all.is_set():
            while pull.poll(0):
                by_zeromq.append(json.loads(pull.recv()))

    with zmq.Context() as context, context.socket(zmq.PULL) as pull:
        port = pull.bind_to_random_port("tcp://127.0.0.1")
        receiving = [threading.Thread(target=one) for one in (receive, pull_all)]
        for one in receiving:
            one.start()
        send = ("--send", f"zeromq:tcp://127.0.0.1:{port}", "--send", f"lsl:{name}")
        ended = live.play(tmp_path / "out", *_camera("my_camera:make", *send))
        ended_all.set()
        for one in receiving:
            one.join()
        go.touch()
    records = _records(ended, tmp_path / "out")
    for facts in json.loads((tmp_path / "out" / "summary.json").read_text())["outputs"]:
        # On a busy machine ZeroMQ may refuse a message, which is counted; what was sent has arrived.
        received = by_lsl if facts["output"].startswith("lsl") else by_zeromq
        assert len(received) == facts["sent"] == FRAMES - facts["overtaken"] - facts["failed"] > 0
    area = labels.index("gross_contact_area")
    found = {int(one[0]): one[area] for one in by_lsl}, {one["frame"]: one["gross_contact_area"] for one in by_zeromq}
    for values in found:
        for number, value in values.items():
            assert value == pytest.approx(float(records["gross_contact_area"][number]), rel=1e-6)


def test_forces_of_a_function_go_into_records_and_outputs(live: LabPC, tmp_path: Path) -> None:
    forces = ("--forces", "callback:my_sensor:make", "--send", "callback:my_sensor:take")
    records = _records(live.play(tmp_path / "out", *_camera("my_camera:make", *forces)), tmp_path / "out")
    known = np.isfinite(records["normal_force"])
    assert known.any()  # of all frames, on a machine that reads the sensor at least every 50 ms
    np.testing.assert_allclose(records["normal_force"][known], 1.5, rtol=1e-6)
    np.testing.assert_allclose(records["tangential_force"][known], 0.5, rtol=1e-6)
    taken = dict(line.split() for line in (live.bundle / "taken.txt").read_text().splitlines())
    for number, force in taken.items():
        assert float(force) == pytest.approx(float(records["normal_force"][int(number)]), nan_ok=True)


def test_the_benchmark_heeds_the_engine(live: LabPC) -> None:
    ended = live.run("-m", "fingerflow.player", "--benchmark", *live.options, "--threads", "1")
    assert ended.returncode == 0, ended.stderr
    first, *_, last = ended.stdout.splitlines()
    assert f", computed by {live.options[1]}" in first
    assert last.startswith("This PC holds ")
