"""Tests of cameras, force sensors, outputs and the benchmark on a lab PC that has NumPy and onnxruntime, or NumPy
alone, and beside them the one package that an output or a camera needs.
"""

import contextlib
import json
import os
import shutil
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fingerflow import player
from tests.export.lab_pc import ENGINES, LabPC, set_up
from tests.player import simulated_gentl
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
LOOP = """
import sys

from fingerflow import player

engine, output = sys.argv[1:]
found, looped = [], []


def take(to, frame, values):  # all but how long it took
    to.append((frame.number, str({name: value for name, value in values.items() if name != "latency"})))


options = {"frames": 72, "page": "off", "engine": engine, "threads": 1}
summary = player.play(".", "synthetic", lambda *given: take(found, *given), output=output + "/called", **options)
for given in player.live_frames(".", "synthetic", output=output + "/looped", **options):
    take(looped, *given)
print(summary["processed"], *[number for number, _ in found])
print(len(looped), found == looped)
"""


@pytest.fixture(scope="module", params=ENGINES)
def live(request: pytest.FixtureRequest, bundle_of_trials: Path, tmp_path_factory: pytest.TempPathFactory) -> LabPC:
    """Return a lab PC with the recording of a press, a camera wrapper, a sensor, and a simulated GenTL producer."""
    lab = set_up(tmp_path_factory.mktemp("lab"), bundle_of_trials, request.param)
    write_trial(lab.bundle / "trial")
    (lab.bundle / "my_camera.py").write_text(CAMERA)
    (lab.bundle / "my_sensor.py").write_text(SENSOR)
    (lab.bundle / "go").touch()
    (lab.bundle / "harvesters").mkdir()
    (lab.bundle / "harvesters" / "__init__.py").touch()
    shutil.copy(simulated_gentl.__file__, lab.bundle / "harvesters" / "core.py")
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


def test_a_gentl_camera_is_read_by_harvesters(live: LabPC, of_file: Records, tmp_path: Path) -> None:
    script = (
        "import sys, numpy as np\nfrom harvesters.core import Harvester\nfrom fingerflow import player\n"
        "frames = np.load('trial/frames.npy')\n"
        "Harvester.frames = [(frame, 10**9 + 4_000_000 * k) for k, frame in enumerate(frames)]\n"
        "sys.exit(player.main(sys.argv[1:]))"
    )
    (live.bundle / "maker.cti").touch()
    always = (".", "--output", str(tmp_path / "out"), "--page", "off", "--threads", "1", *live.options)
    ended = live.run("-c", script, *always, *_camera("genicam:maker.cti,serial=17,ExposureTime=900"))
    records = _records(ended, tmp_path / "out")
    for name in SEEN:
        np.testing.assert_array_equal(records[name], of_file[name], err_msg=name)
    np.testing.assert_allclose(records["time"], np.arange(FRAMES) * 0.004, atol=1e-9)


def test_opencv_is_a_camera_where_it_is_installed(live: LabPC, of_file: Records, tmp_path: Path) -> None:
    """A video takes the place of a camera: OpenCV opens both in the same way. Its codec loses nothing."""
    refused = live.play(tmp_path / "refused", *_camera("opencv:0"))
    assert refused.returncode == 2
    assert "`pip install opencv-python-headless`" in refused.stderr
    frames = np.load(live.bundle / "trial" / "frames.npy")
    path, (height, width) = live.bundle / "trial.avi", frames.shape[1:]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 50.0, (width, height), isColor=False)
    for frame in frames:
        writer.write(frame)
    writer.release()
    live.install("opencv-contrib-python-headless")
    records = _records(live.play(tmp_path / "out", *_camera("opencv:trial.avi")), tmp_path / "out")
    for name in SEEN:
        np.testing.assert_array_equal(records[name], of_file[name], err_msg=name)


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


def test_a_function_and_a_loop_get_every_frame(live: LabPC, tmp_path: Path) -> None:
    """A source without a rate waits for the function and for the loop, so that both get the same values."""
    ended = live.run("-c", LOOP, live.options[1], str(tmp_path))
    assert ended.returncode == 0, ended.stderr
    called, looped = ended.stdout.splitlines()[-2:]
    assert [int(one) for one in called.split()] == [FRAMES, *range(FRAMES)]
    assert looped == f"{FRAMES} True"


def test_forces_of_a_function_go_into_records_and_outputs(live: LabPC, tmp_path: Path) -> None:
    forces = ("--forces", "callback:my_sensor:make", "--send", "callback:my_sensor:take")
    records = _records(live.play(tmp_path / "out", *_camera("my_camera:make", *forces)), tmp_path / "out")
    _check_forces(records, 1.5, 0.5)
    taken = dict(line.split() for line in (live.bundle / "taken.txt").read_text().splitlines())
    for number, force in taken.items():
        assert float(force) == pytest.approx(float(records["normal_force"][int(number)]), nan_ok=True)


@contextlib.contextmanager
def _repeated(send: Callable[[], None]) -> Iterator[None]:
    """Call a function every 5 ms in a thread of its own, as a sensor sends, until the context ends."""
    ended = threading.Event()

    def sensor() -> None:
        while not ended.wait(0.005):
            send()

    sending = threading.Thread(target=sensor)
    sending.start()
    try:
        yield
    finally:
        ended.set()
        sending.join()


def test_forces_of_a_serial_line_go_into_records(live: LabPC, tmp_path: Path) -> None:
    terminal, line = os.openpty()
    os.set_blocking(terminal, False)  # nobody reads before the player has opened the line

    def send() -> None:
        with contextlib.suppress(BlockingIOError):
            os.write(terminal, b"2.25, 0.3, 0.4\n")

    try:
        with _repeated(send):
            camera = _camera("my_camera:make", "--forces", f"serial:{os.ttyname(line)}")
            records = _records(live.play(tmp_path / "out", *camera), tmp_path / "out")
    finally:
        os.close(terminal)
        os.close(line)
    _check_forces(records, 2.25, 0.5)


def test_forces_of_lsl_go_into_records(live: LabPC, tmp_path: Path) -> None:
    lsl = pytest.importorskip("pylsl", reason="the package pylsl is not installed")
    live.install("pylsl")
    name = f"force-of-bundle-{os.getpid()}"
    outlet = lsl.StreamOutlet(lsl.StreamInfo(name, "force", 2, lsl.IRREGULAR_RATE, lsl.cf_double64, name))
    with _repeated(lambda: outlet.push_sample([3.0, 0.25])):
        camera = _camera("my_camera:make", "--forces", f"lsl:{name}")
        records = _records(live.play(tmp_path / "out", *camera), tmp_path / "out")
    _check_forces(records, 3.0, 0.25)


def _check_forces(records: Records, normal: float, tangential: float) -> None:
    known = np.isfinite(records["normal_force"])
    assert known.any()  # of all frames, on a machine that reads the sensor at least every 50 ms
    np.testing.assert_allclose(records["normal_force"][known], normal, rtol=1e-6)
    np.testing.assert_allclose(records["tangential_force"][known], tangential, rtol=1e-6)


def test_the_benchmark_heeds_the_engine(live: LabPC) -> None:
    ended = live.run("-m", "fingerflow.player", "--benchmark", *live.options, "--threads", "1")
    assert ended.returncode == 0, ended.stderr
    first, *_, last = ended.stdout.splitlines()
    assert f", computed by {live.options[1]}" in first
    assert last.startswith("This PC holds ")
