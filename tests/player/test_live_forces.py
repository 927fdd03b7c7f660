"""Tests of forces of a live sensor and of a recording: which sample a frame gets, and that records, outputs and
triggers use it.
"""

import os
import sys
import threading
import time
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from tiny_bundle import Stream, frame, write_scene

from fingerflow import open_stream, player
from fingerflow.errors import PlayerError
from fingerflow.player.addresses import open_address
from fingerflow.player.live_forces import LiveForces, SensorForces
from fingerflow.player.options import SENSORS
from fingerflow.player.sensors.callback_sensor import CallbackSensor
from fingerflow.player.sensors.sensor import ForceSample, parse_sample


class Recorded:
    """A sensor that gives these samples at once and no more after them."""

    def __init__(self, samples: list[ForceSample]) -> None:
        self._left = iter(samples)
        self.ended = threading.Event()

    def read(self) -> ForceSample | None:
        sample = next(self._left, None)
        if sample is None:
            self.ended.set()
            time.sleep(0.01)
        return sample

    def close(self) -> None: ...


def test_a_frame_has_the_sample_nearest_in_time() -> None:
    sensor = Recorded([ForceSample(10 + k / 100, k, -k) for k in range(100)])
    forces = SensorForces(sensor, "recorded")
    assert sensor.ended.wait(30)
    assert forces.read(0, 10.504) == {"normal_force": 50, "tangential_force": -50}
    assert forces.read(0, 10.506)["normal_force"] == 51
    assert forces.read(0, 9.96)["normal_force"] == 0
    assert forces.read(0, 11.03)["normal_force"] == 99
    # More than 50 ms from every sample, and before the first one, the force is unknown.
    for unknown in (9.94, 11.05):
        assert np.isnan(list(forces.read(0, unknown).values())).all()
    forces.close()


@pytest.mark.parametrize(("given", "normal", "tangential"), [((2.0,), 2, np.nan), ((2, -3), 2, -3), ((2, 3, 4), 2, 5)])
def test_one_to_three_forces_are_a_sample(given: tuple[float, ...], normal: float, tangential: float) -> None:
    found = parse_sample(1.0, given)
    assert (found.time, found.normal) == (1, normal)
    assert found.tangential == pytest.approx(tangential, nan_ok=True)
    with pytest.raises(PlayerError, match="the force sensor gives 4 numbers; it must give the normal force"):
        parse_sample(1.0, (1, 2, 3, 4))


def test_forces_go_into_records_outputs_and_triggers(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    """Forces of the scene are in the data set of the stream, trigger an output, and are sent with it: the force grows
    by 0.1 N a frame, so that the condition `normal_force > 0.45 N` triggers at frame 5.
    """
    values = list[dict[str, float]]()
    _module(monkeypatch, take=lambda stamp, given: values.append({"frame": stamp.number, **given}))
    np.save(stream.bundle / "frames.npy", np.stack([frame(contact_px=10 * k) for k in range(8)]))
    given = '[recording]\nframes = "frames.npy"\nframe_rate = 500.0\n[forces]\nfile = "f.csv"\nnormal = "Fn"\n'
    write_scene(stream.scene, given)
    (stream.bundle / "f.csv").touch()
    forces = LiveForces(0, {"normal_force": 0.1 * np.arange(8)})
    stream.play = lambda arguments: player.main(arguments, forces_of=lambda scene: forces)
    stream.run("--when", "normal_force > 0.45 N", "--then", "callback:sensor_of_the_test:take")
    opened = open_stream(stream.folder / "results")
    np.testing.assert_allclose(opened.normal_force, 0.1 * np.arange(8), atol=1e-12)
    (sent,) = values
    assert (sent["frame"], sent["normal_force"]) == (5, pytest.approx(0.5))
    assert opened.normal_force.units == "N"
    assert "tangential_force" not in opened


def _module(monkeypatch: pytest.MonkeyPatch, **members: Any) -> None:
    module = ModuleType("sensor_of_the_test")
    vars(module).update(members)
    monkeypatch.setitem(sys.modules, module.__name__, module)


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals")
def test_a_sensor_on_a_serial_line_gives_a_sample_a_line() -> None:
    terminal, line = os.openpty()
    sensor = open_address(SENSORS, "force sensor", f"serial:{os.ttyname(line)}")
    os.write(terminal, b"25, 0.1\n1.25, 0.3, 0.4\n2.5\nnone\n")  # the first line may have been cut
    first, second = sensor.read(), sensor.read()
    assert (first.normal, first.tangential) == (1.25, 0.5)
    assert second.normal == 2.5
    with pytest.raises(ValueError, match="none"):
        sensor.read()
    os.write(terminal, b"3")
    assert sensor.read() is None  # the line has not ended
    os.write(terminal, b".5\n")
    assert sensor.read().normal == 3.5
    sensor.close()
    os.close(terminal)
    os.close(line)


def test_a_sensor_that_fails_is_read_again_and_is_said(caplog: pytest.LogCaptureFixture) -> None:
    given = iter([(1.0, 0.0), OSError("cable"), (2.0, 0.0)])
    ended = threading.Event()

    def read() -> Any:
        found = next(given, None)
        if isinstance(found, Exception):
            raise found
        if found is None:
            ended.set()
        return found

    forces = SensorForces(CallbackSensor(read), "own")
    assert ended.wait(30)
    assert forces.read(0, time.perf_counter() - 1e-4)["normal_force"] in (2.0, pytest.approx(np.nan, nan_ok=True))
    forces.close()
    assert "own: no force: cable" in caplog.text


@pytest.mark.parametrize("normal", ["normal_force", "Fz"])
def test_a_stream_of_lsl_is_a_sensor(normal: str) -> None:
    lsl = pytest.importorskip("pylsl", reason="the package pylsl is not installed: its sensor is not tested")
    name = f"{normal}-{os.getpid()}"
    info = lsl.StreamInfo(name, "force", 3, lsl.IRREGULAR_RATE, lsl.cf_double64, name)
    described = info.desc().append_child("channels")
    for label, unit in (("trigger", ""), ("tangential_force", "N"), (normal, "N")):
        described.append_child("channel").append_child_value("label", label).append_child_value("unit", unit)
    outlet = lsl.StreamOutlet(info)
    if normal == "Fz":
        with pytest.raises(PlayerError, match="tangential_force only"):
            open_address(SENSORS, "force sensor", f"lsl:{name}")
        return
    sensor = open_address(SENSORS, "force sensor", f"lsl:{name}")
    for _ in range(100):
        outlet.push_sample([1.0, 0.5, 2.0])
        sent = time.perf_counter()
        if (sample := sensor.read()) is not None:
            break
    assert sample is not None
    assert (sample.normal, sample.tangential) == (2.0, 0.5)
    assert sample.time == pytest.approx(sent, abs=1.0)  # the first sample to arrive may be one of a second before
    sensor.close()
