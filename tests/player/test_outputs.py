"""Tests of outputs of live values: each output is received by a program of its kind, triggers fire once a rise, and
lost messages are counted.
"""

import importlib
import json
import os
import socket
import struct
import sys
import threading
from collections.abc import Iterator, Mapping
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from tiny_bundle import Ended, Stream, frame

from fingerflow.errors import PlayerError
from fingerflow.player.camera_clock import unix_now
from fingerflow.player.condition import Condition
from fingerflow.player.handover import Channel
from fingerflow.player.outputs.output import FrameStamp, LiveFrame
from fingerflow.player.sending import Destination, Sender
from fingerflow.schema.variables import VARIABLES

#: Pixels in contact, a quarter of a mm² each: the area rises above 20 mm² three times.
PIXELS = [0, 25, 50, 70, 85, 95, 90, 78, 66, 62, 72, 86, 96, 92, 79, 67, 63, 73, 87, 98, 105]
RISES, DARK = [4, 11, 18], 12


@pytest.fixture
def receiver() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        found.settimeout(20)
        yield found


def _played(stream: Stream, *arguments: str) -> Ended:
    """Play a file of `PIXELS` with frame `DARK` black; every frame waits for the outputs."""
    frames = [frame(contact_px=pixels) for pixels in PIXELS]
    frames[DARK][:] = 0
    np.save(stream.folder / "frames.npy", np.stack(frames))
    ended = stream.run("--source", str(stream.folder / "frames.npy"), *arguments)
    assert ended.code == 0, ended.said
    return ended


def _address(receiver: socket.socket) -> str:
    return "{}:{}".format(*receiver.getsockname())


def _same(sent: Mapping[str, Any], record: Any) -> None:
    for name in ("real_contact_area", "gross_contact_area", "median_divergence", "slip_flag", "contact_threshold"):
        expected = float(record[name])
        assert sent[name] is None if np.isnan(expected) else sent[name] == pytest.approx(expected, rel=1e-6), name


def test_udp_carries_every_frame_with_its_times(stream: Stream, receiver: socket.socket) -> None:
    began = unix_now()
    ended = _played(stream, "--send", f"udp:{_address(receiver)}")
    sent = [json.loads(receiver.recv(4096)) for _ in PIXELS]
    records = ended.results.records
    assert [one["frame"] for one in sent] == list(range(len(PIXELS)))
    assert sent[DARK]["real_contact_area"] is None  # unknown in the dark frame
    for one, record in zip(sent, records, strict=True):
        _same(one, record)
        assert one["ellipse_center_x"] == pytest.approx(float(record["ellipse_center"][0]), nan_ok=True) or (
            one["ellipse_center_x"] is None
        )
        assert began < one["camera_time"] <= one["written"] < unix_now()
        assert one["camera_time"] - ended.summary["first_frame"] == pytest.approx(float(record["time"]), abs=1e-5)
    (facts,) = ended.summary["outputs"]
    assert (facts["sent"], facts["overtaken"], facts["failed"]) == (len(PIXELS), 0, 0)
    # In every frame, and so in the quantiles (bins of 1 %), the output is later than the result.
    assert facts["latency_ms"]["median"] * 1.02 > ended.summary["latency_ms"]["median"] > 0
    assert json.loads((stream.folder / "results" / "summary.json").read_text())["outputs"] == [facts]


def test_osc_is_a_bundle_of_one_message_a_value(stream: Stream, receiver: socket.socket) -> None:
    ended = _played(stream, "--send", f"osc:{_address(receiver)}", "--values", "real_contact_area,slip_flag")
    for record in ended.results.records:
        data = receiver.recv(4096)
        assert data[:16] == b"#bundle\0" + struct.pack(">Q", 1)
        found, place = {}, 16
        while place < len(data):
            (size,) = struct.unpack_from(">i", data, place)
            assert size % 4 == 0
            message, place = data[place + 4 : place + 4 + size], place + 4 + size
            address = message[: message.index(b"\0")]
            kinds = (len(address) // 4 + 1) * 4
            assert message[kinds : kinds + 8] == b",fidd\0\0\0"
            found[address.decode()] = struct.unpack(">fidd", message[kinds + 8 :])
        area, number, camera, written = found["/fingerflow/real_contact_area"]
        assert area == pytest.approx(float(record["real_contact_area"]), nan_ok=True)
        assert number == record["frame"]
        assert ended.summary["first_frame"] <= camera <= written
        assert set(found) == {"/fingerflow/real_contact_area", "/fingerflow/slip_flag"}


def test_zeromq_reaches_a_pull_socket(stream: Stream) -> None:
    zmq = pytest.importorskip("zmq", reason="the package pyzmq is not installed: its output is not tested")
    with zmq.Context() as context, context.socket(zmq.PULL) as pull:
        port = pull.bind_to_random_port("tcp://127.0.0.1")
        received: list[dict[str, Any]] = []

        def receive() -> None:
            while pull.poll(3000 if received else 60000):
                received.append(json.loads(pull.recv()))

        reading = threading.Thread(target=receive)
        reading.start()
        ended = _played(stream, "--send", f"zeromq:tcp://127.0.0.1:{port}")
        reading.join()
    (facts,) = ended.summary["outputs"]
    # Messages fail until the connection stands; all messages that are counted as sent have arrived.
    assert len(received) == facts["sent"] == len(PIXELS) - facts["failed"]
    for one in received:
        _same(one, ended.results.records[one["frame"]])
    (stream.folder / "results").rename(stream.folder / "first")
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))  # bound, but not listening
        ended = _played(stream, "--send", f"zeromq:tcp://127.0.0.1:{nobody.getsockname()[1]}")
    (facts,) = ended.summary["outputs"]
    assert (facts["sent"], facts["failed"]) == (0, len(PIXELS))
    assert "frame 0 was not sent: no receiver takes messages" in ended.said


def test_lsl_is_a_stream_with_labels_units_and_camera_times(stream: Stream) -> None:
    lsl = pytest.importorskip("pylsl", reason="the package pylsl is not installed: its output is not tested")
    name, received = f"test-{os.getpid()}", list[tuple[list[float], float]]()
    labels, units = list[str](), list[str]()
    connected, ended_all = threading.Event(), threading.Event()

    def receive() -> None:
        inlet = lsl.StreamInlet(lsl.resolve_byprop("name", name, timeout=60)[0])
        labels.extend(inlet.info().get_channel_labels())
        units.extend(inlet.info().get_channel_units())
        inlet.open_stream(60)
        connected.set()
        while (found := inlet.pull_sample(timeout=1))[0] is not None or not ended_all.is_set():
            if found[0] is not None:
                received.append(found)

    reading = threading.Thread(target=receive)
    reading.start()
    frames = iter([frame(contact_px=pixels) for pixels in PIXELS])

    def grab() -> Any:
        assert connected.wait(60)
        return next(frames, None)

    ended = stream.run(*stream.camera(lambda: grab), "--policy", "every", "--send", f"lsl:{name}")
    ended_all.set()
    reading.join()
    (facts,) = ended.summary["outputs"]
    assert facts["failed"] == 0
    assert len(received) == facts["sent"] == len(PIXELS) - facts["overtaken"] > 0
    area = labels.index("real_contact_area")
    assert (labels[0], units[area]) == ("frame", "mm2")
    offset = lsl.local_clock() - unix_now()
    for sample, stamp in received:
        record = ended.results.records[int(sample[0])]
        assert sample[area] == pytest.approx(float(record["real_contact_area"]), nan_ok=True)
        # Both clocks are the system's monotonic clock; 5 ms allow for a change of threads between two readings.
        expected = ended.summary["first_frame"] + float(record["time"]) + offset
        assert stamp == pytest.approx(expected, abs=5e-3)


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals")
@pytest.mark.parametrize("windows", [False, True])
def test_a_serial_line_carries_a_line_of_json_a_frame(
    stream: Stream, monkeypatch: pytest.MonkeyPatch, windows: bool
) -> None:
    """A serial line carries one line of JSON for each frame, with termios and with pyserial, which Windows uses and
    which opens a pseudo-terminal here as well; a function gets each frame with its record.
    """
    if windows:
        pytest.importorskip("serial", reason="the package pyserial is not installed, which Windows needs")
        monkeypatch.setattr(importlib.import_module("fingerflow.player.serial_line").sys, "platform", "win32")
    module, found = ModuleType("own_of_the_test"), list[FrameStamp]()
    module.take = lambda stamp, values: found.append(stamp)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    terminal, line = os.openpty()
    own = ("--send", "callback:own_of_the_test:take")
    ended = _played(stream, "--send", f"serial:{os.ttyname(line)}@115200", *own, "--values", "real_contact_area")
    sent = [json.loads(one) for one in os.read(terminal, 65536).decode().splitlines()]
    os.close(terminal)
    os.close(line)
    assert [one["frame"] for one in sent] == list(range(len(PIXELS)))
    assert sent[4]["real_contact_area"] == PIXELS[4] / 4
    for stamp, record in zip(found, ended.results.records, strict=True):
        np.testing.assert_array_equal(stamp.record["position_px"], record["position_px"])


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals")
def test_a_trigger_goes_out_once_a_rise_by_udp_and_by_a_serial_line(stream: Stream, receiver: socket.socket) -> None:
    terminal, line = os.openpty()
    when = ("--when", "real_contact_area > 20 mm2", "--then")
    ended = _played(stream, *when, f"udp:{_address(receiver)}", *when, f"serial:{os.ttyname(line)}:1")
    assert [json.loads(receiver.recv(4096))["frame"] for _ in RISES] == RISES
    receiver.setblocking(False)
    with pytest.raises(BlockingIOError):
        receiver.recv(4096)
    assert os.read(terminal, 100) == b"1" * len(RISES)
    os.close(terminal)
    os.close(line)
    for facts in ended.summary["outputs"]:
        assert (facts["sent"], facts["overtaken"], facts["failed"]) == (len(RISES), 0, 0)
    found = [event["frame"] for event in ended.results.events if event["event"] == "trigger"]
    assert sorted(found) == sorted(RISES * 2)


class Slow:
    """An output that is busy until the test sets `go`; the message of frame 7 fails."""

    def __init__(self) -> None:
        self.taken = Channel[int](100)
        self.go = threading.Event()

    def send(self, stamp: FrameStamp, values: Mapping[str, float]) -> None:
        self.taken.put(stamp.number)
        assert self.go.wait(30)
        if stamp.number == 7:
            raise OSError("gone")

    def close(self) -> None: ...


def _message(number: int, area: float = 0.0) -> LiveFrame:
    return FrameStamp(number, unix_now(), np.nan, np.zeros(1)), {"area": area}


@pytest.mark.parametrize("sent_within", [0.0, np.inf])
def test_the_newest_frame_waits_for_an_output_that_is_busy(sent_within: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the messages that wait for a busy output only the newest is sent, or all if sending all takes less than a
    limit.
    """
    monkeypatch.setattr("fingerflow.player.sending._CATCH_UP", sent_within)
    slow = Slow()
    sender = Sender(Destination("slow", slow, ("area",)))
    sender.offer(_message(0))
    assert slow.taken.get() == 0
    for number in range(1, 8):
        sender.offer(_message(number))
    slow.go.set()
    sender.close()
    expected = [*range(1, 8)] if sent_within else [7]
    assert [slow.taken.get() for _ in expected] == expected
    assert (sender.sent, sender.overtaken, sender.failed) == (len(expected), 7 - len(expected), 1)


VALUES = {one: VARIABLES[one] for one in ("real_contact_area", "gross_contact_area", "median_divergence", "slip_flag")}
VALUES |= {one: VARIABLES[one] for one in ("normal_force", "ellipse_angle")}


@pytest.mark.parametrize(
    ("text", "name", "limit"),
    [
        ("gross_contact_area > 20 mm2", "gross_contact_area", 20),
        ("gross_contact_area>=20mm²", "gross_contact_area", 20),
        ("median_divergence < -15 um/mm", "median_divergence", -0.015),
        ("median_divergence > 1.5 %", "median_divergence", 0.015),
        ("slip_flag > 0.5", "slip_flag", 0.5),
        ("ellipse_angle > 90 deg", "ellipse_angle", np.pi / 2),
    ],
)
def test_a_condition_is_read_by_the_record_of_the_variable(text: str, name: str, limit: float) -> None:
    found = Condition(text, VALUES)
    assert found.name == name
    assert found.limit == pytest.approx(limit)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("gross_contact_area > 20", "is measured in 'mm2' or 'mm²', and the condition gives no unit behind the number"),
        ("gross_contact_area > 20 cm2", "is measured in 'mm2' or 'mm²', not in 'cm2'"),
        ("gross_area > 20 mm2", "there is no live value 'gross_area'; did you mean 'gross_contact_area'? there are "),
        ("gross_contact_area = 20 mm2", "is no condition such as"),
        ("gross_contact_area > 2.0.1 mm2", "a number has one decimal point"),
    ],
)
def test_another_condition_is_refused_in_a_sentence(text: str, said: str) -> None:
    with pytest.raises(PlayerError) as refused:
        Condition(text, VALUES)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("text", "given", "rises"),
    [
        ("gross_contact_area > 20 mm2", [np.nan, 25, 25, np.nan, 26, 20, np.nan, 21, 19, np.nan], [1, 7]),
        ("gross_contact_area > 20 mm2, margin 2", [21, 19, 21, 18.1, 21, 18, 21, 19], [0, 6]),
        ("median_divergence < -15 um/mm, margin 5", [-0.016, -0.014, -0.016, -0.009, -0.012, -0.016], [0, 5]),
    ],
)
def test_a_condition_rises_once_and_beyond_its_margin_again(text: str, given: list[float], rises: list[int]) -> None:
    """An unknown value changes nothing."""
    condition = Condition(text, VALUES)
    found = [condition.becomes_true({condition.name: value}) for value in given]
    assert np.flatnonzero(found).tolist() == rises


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--send", "tcp:127.0.0.1:5"), "output 'tcp:127.0.0.1:5': there is no kind 'tcp'; give one of callback"),
        (("--send", "udp:127.0.0.1"), "'127.0.0.1' is no HOST:PORT; its form is udp:HOST:PORT"),
        (("--send", "zeromq:127.0.0.1"), "is no tcp://HOST:PORT"),
        (("--send", "serial:/nowhere"), "/nowhere cannot be opened (No such file or directory)"),
        (("--send", "serial:/dev/null"), "/dev/null is no serial line"),
        (("--send", "callback:json:nothing"), "has no attribute 'nothing'"),
        (("--send", "udp:127.0.0.1:9", "--values", "area"), "--values: there is no live value 'area'; there are"),
        (("--when", "slip_flag > 0"), "1 --when and 0 --then: give one --then after each --when"),
        (("--forces", "udp:1"), "force sensor 'udp:1': there is no kind 'udp'; give one of callback:MODULE:FACTORY"),
    ],
)
def test_wrong_outputs_are_named(stream: Stream, arguments: tuple[str, ...], said: str) -> None:
    assert said in stream.refused(*stream.recorded(1), *arguments)


@pytest.mark.parametrize(("kind", "package"), [("zeromq:tcp://127.0.0.1:9", "pyzmq"), ("lsl:a", "pylsl")])
def test_a_package_that_is_not_there_is_named(
    stream: Stream, monkeypatch: pytest.MonkeyPatch, kind: str, package: str
) -> None:
    for name in ("zmq", "pylsl"):
        monkeypatch.setitem(sys.modules, name, None)
    said = stream.refused(*stream.recorded(1), "--send", kind)
    assert f"needs the package {package}: `pip install {package}`" in said
