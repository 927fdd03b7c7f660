"""Tests of cameras: the clock of their time stamps, GenICam with a simulated and a real GenTL producer, and OpenCV."""

import sys
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest
from simulated_gentl import Harvester
from tiny_bundle import Stream, frame

from fingerflow.errors import PlayerError
from fingerflow.player.camera_clock import CameraClock
from fingerflow.player.sources.camera_source import open_camera


def test_a_clock_tells_late_arrivals_from_the_offset() -> None:
    """The clock takes the shortest transfer as the offset between the clocks of camera and computer, and longer
    transfers as latency: a camera counts from 100 s at 250 Hz, its transfers take 2 ms and more, and 42 ms after the
    fourth frame.
    """
    clock, late = CameraClock(), np.array([3, 2, 4, 2, 42, 38, 34, 2.5]) / 1e3
    stamps = 100 + np.arange(len(late)) / 250
    seen = [clock.update(stamp, 7000 + stamp - 100 + one) for stamp, one in zip(stamps, late, strict=True)]
    intervals, latencies = np.diff([one[0] for one in seen]), 7000 + stamps - 100 + late - [one[1] for one in seen]
    np.testing.assert_allclose(intervals, 1 / 250, atol=1e-9)
    # From the second frame on the shortest transfer, 2 ms, is known: the time beyond it is latency.
    np.testing.assert_allclose(latencies[1:], late[1:] - 2e-3, atol=1e-9)
    assert clock.has_stamps
    # Of a drift of 100 ppm, 6 ms in a minute, at most 1 ms is latency: the offset is measured within 5 to 10 s.
    stamps = np.arange(0, 60, 0.05)
    for drift in (1 - 1e-4, 1 + 1e-4):
        clock = CameraClock()
        drifting = [stamp * drift - clock.update(stamp, stamp * drift)[1] for stamp in stamps]
        assert 0 <= min(drifting) <= max(drifting) <= 1.1e-3


_EVEN = 100 + np.arange(60) / 100  # s


@pytest.mark.parametrize(
    ("stamps", "exact"),
    [
        (_EVEN, 0),
        # ms, us and ns for s: the unit is found within a tenth of a second; minutes, hours and days: within 5 s.
        *((_EVEN * unit, 12) for unit in (1e3, 1e6, 1e9)),
        *((np.arange(700) / 100 / unit, 504) for unit in (60, 3600, 86400)),
        (np.arange(60.0), None),  # the number of the frame: refused
        (_EVEN + 1e6 * (np.arange(60) > 30), None),  # jumps forth, back, and to what is no number
        (np.where(np.arange(60) > 1, _EVEN - 50, _EVEN), None),  # starts again
        (np.where(np.arange(60) == 20, 1e6, _EVEN), None),
        (np.where(np.arange(60) == 20, np.nan, _EVEN), None),
        (np.where(np.arange(60) % 7 == 3, np.inf, _EVEN), None),
        (np.where(np.arange(60) % 2 == 0, -np.inf, _EVEN), None),
        (np.full(60, 5.0), None),
        (np.floor(20 * _EVEN) / 20, None),  # of 0.05 s, so that most repeat
        (_EVEN - 0.011 * (np.arange(60) % 5 == 4), None),  # back by 1 ms
    ],
)
def test_time_never_runs_backwards_or_away_from_arrivals(
    stamps: np.ndarray[Any, Any], exact: int | None, caplog: pytest.LogCaptureFixture
) -> None:
    clock, late = CameraClock(), 2e-3 * np.random.default_rng(1).random(len(stamps))
    arrivals = 7000 + np.arange(len(stamps)) / 100 + late
    pairs = zip(stamps.tolist(), arrivals.tolist(), strict=True)
    times, exposed = np.transpose([clock.update(*pair) for pair in pairs])
    assert (np.diff(times) > 0).all()
    assert caplog.text.count("does not follow the one before") <= 1
    assert np.abs(times - arrivals)[exact or 0 :].max() < 0.03
    assert np.abs(exposed - arrivals)[exact or 0 :].max() < 0.03
    if exact is not None:
        np.testing.assert_allclose(np.diff(times[exact:]), 0.01, atol=1e-6)


@pytest.mark.parametrize("rate", [0.5, 0.9, 1.1, 2.0, 1.0])
def test_stamps_of_another_rate_are_refused(rate: float, caplog: pytest.LogCaptureFixture) -> None:
    """Stamps at the true rate are believed although 60 frames wait for 3 s and a fifth of the frames are dropped."""
    clock, true = CameraClock(), np.delete(np.arange(0, 16, 0.05), slice(3, None, 5))
    arrivals = np.where((true > 6) & (true < 9), 9, true) + 2e-3 * np.random.default_rng(1).random(len(true))
    times = [clock.update(*pair)[0] for pair in zip((5 + rate * true).tolist(), sorted(arrivals), strict=True)]
    assert clock.has_stamps == (rate == 1) == ("they are not used" not in caplog.text)
    np.testing.assert_allclose(np.diff(times[-80:]), np.diff(true[-80:]), atol=2.1e-3)


def test_time_stamps_of_a_wrapper_are_those_of_the_records(stream: Stream) -> None:
    stamps = 5 + np.array([0, 0.003, 0.006, 0.0095, 0.012])
    given = [(frame(contact_px=10 * k), stamp) for k, stamp in enumerate(stamps)]
    ended = stream.run(*stream.frames(given), "--policy", "every")
    np.testing.assert_allclose(ended.results.records["time"], stamps - 5, atol=1e-9)
    assert ended.summary["time_stamps"] == "camera"
    without = [frame(contact_px=10 * k) for k in range(3)]
    (stream.folder / "results").rename(stream.folder / "before")
    assert stream.run(*stream.frames(without)).summary["time_stamps"] == "arrival"


@pytest.fixture
def producer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    module, core = ModuleType("harvesters"), ModuleType("harvesters.core")
    core.Harvester = Harvester  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "harvesters", module)
    monkeypatch.setitem(sys.modules, "harvesters.core", core)
    for name, value in (("events", []), ("frames", []), ("kind", "Mono8")):
        monkeypatch.setattr(Harvester, name, value)
    file = tmp_path / "maker.cti"
    file.touch()
    return str(file)


def test_a_gentl_camera_gives_frames_and_its_own_times(stream: Stream, producer: str) -> None:
    Harvester.frames = [(frame(contact_px=10 * k), 10**9 + 4_000_000 * k) for k in range(5)]
    camera = f"genicam:{producer},serial=17,ExposureTime=900,PixelFormat=Mono8"
    records = stream.run("--camera", camera, "--policy", "every", "--frames", "5").results.records
    np.testing.assert_array_equal(records["real_contact_area"], np.arange(5) * 2.5)
    np.testing.assert_allclose(records["time"], np.arange(5) * 0.004, atol=1e-9)
    assert (records["latency"] > 0).all()
    assert Harvester.events == [
        *("maker.cti", "create 17", "ExposureTime=900", "PixelFormat=Mono8", "start", "stop", "destroy", "reset")
    ]


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("{},serial=18", "finds the cameras 17; is it on?"),
        ("{},Exposure=1", "the camera has no feature 'Exposure'"),
        ("{},ExposureTime=", "the camera does not take ExposureTime= (no value)"),
        ("nowhere.cti", "nowhere.cti: is no file; give the .cti file"),
    ],
)
def test_what_a_gentl_camera_does_not_have_is_named(producer: str, asked: str, said: str) -> None:
    with pytest.raises(PlayerError) as refused:
        open_camera(f"genicam:{asked.format(producer)}")
    assert said in str(refused.value)
    assert Harvester.events[-1:] in ([], ["reset"])  # nothing stays open


def test_a_gentl_camera_of_colours_is_refused(producer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Harvester, "kind", "BayerRG8")
    Harvester.frames = [(frame(), None)]
    with pytest.raises(PlayerError, match="gives BayerRG8: set its PixelFormat to Mono8"):
        open_camera(f"genicam:{producer}").read()


def test_a_real_gentl_producer_by_harvesters() -> None:
    """Frames are read by harvesters from the GenTL producer of the package genicam, whose three simulated cameras give
    no time stamps.
    """
    pytest.importorskip("harvesters", reason="the package harvesters is not installed: only a simulated one is tested")
    found = find_spec("genicam")
    assert found is not None
    assert found.origin is not None
    file = Path(found.origin).with_name("viky.cti")
    if not file.exists():
        pytest.skip("this version of the package genicam ships no producer")
    camera = open_camera(f"genicam:{file},serial=1,PixelFormat=Mono8")
    frames = [camera.read() for _ in range(3)]
    assert np.isnan(camera.stamp)
    camera.close()
    assert {(one.shape, str(one.dtype)) for one in frames if one is not None} == {((400, 400), "uint8")}
    colour = open_camera(f"genicam:{file},PixelFormat=RGBa8")
    with pytest.raises(PlayerError, match="gives RGBa8: set its PixelFormat"):
        colour.read()
    colour.close()


def test_opencv_gives_grey_frames_and_times(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The camera of OpenCV gives grey frames and time stamps. A video file takes the place of a camera, because OpenCV
    opens both in the same way.
    """
    path = str(tmp_path / "a.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"MJPG"), 50.0, (96, 64))
    for grey in (40, 90, 140):
        writer.write(np.full((64, 96, 3), grey, np.uint8))
    writer.release()
    camera = open_camera(f"opencv:{path}")
    stamps = []
    for grey in (40, 90, 140):
        found = camera.read()
        assert found is not None
        assert found.shape == (64, 96)
        assert abs(int(found.mean()) - grey) <= 2
        stamps.append(camera.stamp)
    assert stamps[2] - stamps[1] == pytest.approx(0.02, abs=1e-3)
    with pytest.raises(OSError, match="the camera gave no frame"):
        camera.read()
    camera.close()
    with pytest.raises(PlayerError, match="OpenCV finds no camera '97'"):
        open_camera("opencv:97")
