"""Tests of what a stream does with its frames: policies, key frames, restarts, errors of the source, results."""

import json
import os
import signal
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from tiny_bundle import HEIGHT, PLACES, POINTS, WIDTH, Stream, frame

from fingerflow import player
from fingerflow.engines.native import NativeEngine
from fingerflow.errors import FingerflowError
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.player import stream_player as stream_module
from fingerflow.tracker.frame_results import FrameResults
from fingerflow.tracker.frame_tracker import Frame, StreamTracker
from fingerflow.tracker.reseeding import ReseedingSchedule


def test_a_recording_gives_one_record_a_frame(stream: Stream) -> None:
    ended = stream.run(*stream.recorded(40), "--json", str(stream.folder / "summary.json"))
    assert ended.code == 0
    assert (ended.summary["frames_in"], ended.summary["processed"], ended.summary["dropped"]) == (40, 40, 0)
    assert json.loads((stream.folder / "summary.json").read_text()) == ended.summary
    records, header, events = ended.results
    np.testing.assert_array_equal(records["frame"], np.arange(40))
    np.testing.assert_array_equal(records["real_contact_area"], np.arange(40) * 10 * 0.5**2)  # mm_per_px is 0.5
    np.testing.assert_array_equal(records["position_px"], np.broadcast_to(PLACES, (40, POINTS, 2)))
    np.testing.assert_array_equal(records["status"], TrackStatus.TRACKED)
    assert (records["latency"] > 0).all()
    assert "real_contact_mask" not in (records.dtype.names or ())
    units = {field["name"]: field["unit"] for field in header["fields"]}
    assert (units["real_contact_area"], units["forward_backward_error"]) == ("mm2", "px")
    assert [event["event"] for event in events] == ["restart"]


def test_a_raw_file_and_a_video_give_the_same(stream: Stream) -> None:
    """A raw file and a video give the same areas; a video that is cut is played to its end, and the log says so."""
    cv2 = pytest.importorskip("cv2")
    frames = [frame(contact_px=10 * number) for number in range(20)]
    np.stack(frames).tofile(stream.folder / "frames.raw")
    path, size = stream.folder / "frames.avi", (2 * WIDTH, HEIGHT)
    video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"FFV1"), 30, size, False)
    if not video.isOpened():
        pytest.skip("this OpenCV cannot write a lossless video")
    for picture in frames:
        video.write(picture)
    video.release()
    whole, areas = path.read_bytes(), np.arange(20) * 2.5
    (stream.folder / "cut.avi").write_bytes(whole[: len(whole) * 3 // 4])
    shape = ("--shape", str(HEIGHT), str(2 * WIDTH))
    for name, arguments in (("frames.raw", shape), ("frames.avi", ()), ("cut.avi", ())):
        played = stream.run("--source", str(stream.folder / name), *arguments)
        count = len(played.results.records)
        np.testing.assert_array_equal(played.results.records["real_contact_area"], areas[:count])
        cut = f"cut.avi: ends after {count} of 20 frames, as it is damaged or cut; copy it again" in played.said
        assert (count < 19 and cut) if name == "cut.avi" else (count == 20 and not cut)
        (stream.folder / "results").rename(stream.folder / f"of {name}")


@pytest.mark.parametrize("policy", ["every", "latest"])
def test_a_policy_loses_nothing_or_takes_the_newest_frame(
    stream: Stream, monkeypatch: pytest.MonkeyPatch, policy: str
) -> None:
    """A paced source twice as fast as the engine: with `every` the source waits, and the waits are counted as overruns;
    with `latest` frames are dropped, and the newest one is computed.
    """
    step = StreamTracker.step
    monkeypatch.setattr(StreamTracker, "step", lambda *frame: (time.sleep(0.004), step(*frame))[1])
    ended = stream.run(*stream.recorded(60), "--rate", "500", "--queue", "4", "--policy", policy)
    summary, numbers = ended.summary, ended.results.records["frame"]
    assert summary["frames_in"] == summary["processed"] + summary["dropped"] == 60
    assert len(numbers) == summary["processed"]
    assert numbers[-1] == 59
    assert (np.diff(numbers) > 0).all()
    assert (summary["dropped"] > 0) == (summary["overruns"] == 0) == (policy == "latest")
    if policy == "every":  # waiting counts as latency, from the time at which a camera would have given the frame
        assert ended.results.records["latency"][-1] > 0.05


def test_results_of_a_burst_do_not_wait_for_the_frame_after_it(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    compute = StreamTracker.compute_results
    monkeypatch.setattr(StreamTracker, "compute_results", lambda *frames: (time.sleep(0.01), compute(*frames))[1])

    def bursts() -> Iterator[Any]:
        for count in (9, 10, 11, 12, 1):
            yield from [frame()] * count
            time.sleep(0.4)

    ended = stream.run(*stream.frames(bursts()), "--policy", "every")
    assert ended.results.records["latency"].max() < 0.3


def test_frames_that_wait_for_a_threshold_are_not_behind(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    stream.scene.write_text(stream.scene.read_text().replace("threshold = 0.5", ""))
    said, describe = list[str](), stream_module.Player._falls_behind
    monkeypatch.setattr(stream_module.Player, "_falls_behind", lambda *given: said.append(describe(*given)) or said[-1])
    pictures = ((time.sleep(0.12), frame())[1] for _ in range(20))
    assert stream.run(*stream.frames(pictures), "--policy", "every").results.records["latency"].max() > 0.3
    assert set(said) == {""}


#: Numbers of spots and of spots that have moved elsewhere, for each frame of a stream with a new key frame (7 of 10
#: points are found in four frames) and a restart (4 of 10 in four frames).
FOUND = [(10, 0)] * 4 + [(7, 0)] * 6 + [(6, 0)] * 2 + [(10, 6)] * 10
TRACKED = np.array([10] * 4 + [7] * 6 + [6] * 2 + [4] * 4 + [10] * 6)


def _frames() -> list[Any]:
    return [frame(found, elsewhere=elsewhere) for found, elsewhere in FOUND]


def test_points_are_keyed_anew_and_chosen_anew(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every frame has its own result, in order. A key frame and a restart take effect in the frame after the one that
    causes them.
    """
    monkeypatch.setattr(ReseedingSchedule, "_RESTART", 0)
    ended = stream.run(*stream.frames(_frames()), "--policy", "every")
    records, number = ended.results.records, np.arange(len(FOUND))
    np.testing.assert_array_equal(records["frame"], number)
    events = [(event["event"], event["frame"], event["points"]) for event in ended.results.events]
    assert events == [("restart", 0, 10), ("key_frame", 7, 7), ("restart", 15, 10)]
    np.testing.assert_array_equal(records["key_frame"], np.select([number < 8, number < 16], [0, 7], 15))
    np.testing.assert_array_equal(records["restart"], np.where(number < 16, 1, 2))
    # Points lost before the key frame are not tracked from it, until others are seeded.
    keyed = (number >= 8) & (number < 16)
    late = number[keyed][number[keyed] >= 16]  # the points from before the restart are still tracked
    tracked = np.where(np.isin(number, late), 4, TRACKED)
    np.testing.assert_array_equal((records["status"] == TrackStatus.TRACKED).sum(1), tracked)
    np.testing.assert_array_equal(np.isfinite(records["position_px"][..., 0]).sum(1), tracked)
    assert (records["status"][keyed][:, 7:] == TrackStatus.NOT_FINITE).all()
    assert (records["status"][4:8, 7:] > TrackStatus.NOT_FINITE).all()
    # A point keeps its position when it is tracked from another key frame.
    np.testing.assert_allclose(records["position_px"][:15, :4], np.broadcast_to(PLACES[:4], (15, 4, 2)), atol=0.01)


def test_results_do_not_depend_on_the_clock(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    """Results are the same bit for bit, whatever the pace and the time that each frame takes."""
    monkeypatch.setattr(ReseedingSchedule, "_RESTART", 10)
    stream.scene.write_text(stream.scene.read_text().replace("threshold = 0.5", ""))
    generator = np.random.default_rng(5)
    shown = FOUND + [(10, 0)] * 20 + FOUND
    moved = np.cumsum(generator.choice((-0.5, 0, 0.5), len(shown))).clip(-6, 6)
    given = enumerate(zip(shown, moved, 0.03 * np.sin(np.arange(len(shown)) / 9), strict=True))
    frames = np.stack([frame(one[0], 40 * i % 3000, far, more, one[1]) for i, (one, far, more) in given])
    np.save(stream.folder / "frames.npy", frames)
    source = ("--source", str(stream.folder / "frames.npy"))
    plain = stream.run(*source)
    assert {event["event"] for event in plain.results.events} >= {"restart", "key_frame", "threshold"}
    (stream.folder / "results").rename(stream.folder / "plain")
    step = StreamTracker.step

    def uneven(tracker: StreamTracker, frame: Frame) -> Any:
        time.sleep(float(generator.choice((0, 0, 0, 0.004))))
        return step(tracker, frame)

    monkeypatch.setattr(StreamTracker, "step", uneven)
    other = stream.run(*source, "--rate", "1500")
    reference = player.read_results(stream.folder / "plain").records
    assert np.nanmax(np.ptp(reference["position_px"][:30, :4, 0], axis=0)) > 1
    for name in set(reference.dtype.names or ()) - {"time", "latency"}:
        assert other.results.records[name].tobytes() == reference[name].tobytes(), name
    said = [[(e["event"], e["frame"]) for e in events] for events in (plain.results.events, other.results.events)]
    assert said[0] == said[1]


@pytest.mark.parametrize(
    ("part", "name", "failing"),
    [
        (StreamTracker, "step", 0),
        (StreamTracker, "step", 2),
        (NativeEngine, "contact", 6),
        (FrameResults, "compute", 6),
    ],
)
def test_a_frame_that_fails_ends_the_stream_with_all_before_it(
    stream: Stream, monkeypatch: pytest.MonkeyPatch, part: type, name: str, failing: int
) -> None:
    """A frame that fails ends the stream with the records of all frames before it, also of those with which it is
    measured in one call.
    """
    whole = getattr(part, name)

    def fail(first: Any, *others: Any) -> Any:
        passed = whole(first, *others)
        if name == "step":
            fails = first.seeded and others[0].number == failing  # without points in the warm-up
        else:
            fails = 10 * failing in (passed if name == "contact" else others[1]).real_area_px
        if fails:
            raise RuntimeError("broken engine")
        return passed

    monkeypatch.setattr(part, name, fail)
    with pytest.raises(RuntimeError, match="broken engine"):
        stream.run(*stream.recorded(9))
    results = stream.folder / "results"
    assert results.is_dir() == (failing > 0)  # no empty folder is left
    if failing:
        np.testing.assert_array_equal(player.read_results(results).records["frame"], np.arange(failing))


DARKENED_MM2 = 20 * 30 / 4


def _darkened(level: int, elsewhere: int = 0) -> Any:
    picture = frame(elsewhere=elsewhere)
    picture[10:30, WIDTH + 20 : WIDTH + 50] = level
    return picture


@pytest.mark.parametrize("setting", ["", 'threshold = "reference_frame"'])
def test_a_threshold_that_is_not_given_is_measured(stream: Stream, setting: str) -> None:
    """The threshold is measured in the first frame with contact among every fourth frame: 0.4, half of the loss of
    intensity.

    The threshold applies from the last of these without contact on; later, darker frames do not change it.
    """
    stream.scene.write_text(stream.scene.read_text().replace("threshold = 0.5", setting))
    levels = (200, 200, 40, 40, 40, 40, 40, 10, 130, 10)
    np.save(stream.folder / "frames.npy", np.stack([_darkened(level) for level in levels]))
    ended = stream.run("--source", str(stream.folder / "frames.npy"))
    touching = np.array([level < 100 for level in levels])
    np.testing.assert_array_equal(ended.results.records["real_contact_area"], DARKENED_MM2 * touching)
    [event] = [event for event in ended.results.events if event["event"] == "threshold"]
    assert event["frame"] == 4
    assert event["threshold"] == pytest.approx(0.4, abs=1e-3)  # the bin width of the histogram
    assert ended.summary["threshold"] == event["threshold"]
    assert ended.results.header["threshold"] == "measured"
    assert "frame 4: threshold 0.3995 of the intensity lost" in ended.said


def test_a_restart_that_finds_nothing_is_not_kept(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    """Points that are covered for a while are the same points afterwards: a restart that finds no points is not
    kept.
    """
    monkeypatch.setattr(ReseedingSchedule, "_RESTART", 0)
    black = frame(found=0)
    black[:, :WIDTH] = 0
    frames = [frame()] * 4 + [black] * 10 + [frame()] * 10
    ended = stream.run(*stream.frames(frames), "--policy", "every")
    assert [(event["event"], event["frame"]) for event in ended.results.events] == [("restart", 0)]
    # Three black frames could be a jump that returns; the fourth shows that the picture has changed for good.
    assert not ended.results.records["frame_status"].any()
    np.testing.assert_array_equal(
        np.isfinite(ended.results.records["position_px"][..., 0]).sum(1), [10] * 4 + [0] * 10 + [10] * 10
    )


def test_a_scene_may_key_by_number_and_limit_the_region(stream: Stream) -> None:
    text = stream.scene.read_text()
    stream.scene.write_text(f"{text}[stream]\nupdate_frames = 3\nregion = {{rows = [0, 32], columns = [0, 60]}}\n")
    ended = stream.run(*stream.frames(frame() for _ in range(8)), "--policy", "every")
    np.testing.assert_array_equal(ended.results.records["key_frame"], [0, 0, 0, 0, 3, 3, 3, 6])
    assert [event["points"] for event in ended.results.events] == [3, 3, 3]
    np.testing.assert_array_equal(ended.results.records["position_px"][0, :3], PLACES[:3])
    plain = frame()
    plain[:32, :60] = 90
    (stream.folder / "results").rename(stream.folder / "first")
    ended = stream.run(*stream.frames([plain] * 3), "--policy", "every")
    assert [event["points"] for event in ended.results.events] == [0]  # no spot in the region


def test_a_source_that_fails_is_opened_again(stream: Stream) -> None:
    frames = [frame(), frame(), OSError("cable"), OSError("cable"), frame(), frame()]
    ended = stream.run(*stream.frames(frames), "--policy", "every")
    assert ended.code == 0
    assert (ended.summary["processed"], ended.summary["reconnects"]) == (4, 2)
    assert "OSError: cable" in ended.said
    assert sorted(event["event"] for event in ended.results.events) == ["reconnect", "reconnect", "restart"]


@pytest.mark.parametrize("hangs", [False, True])
def test_a_camera_that_stays_away_or_hangs_ends_the_stream(
    stream: Stream, monkeypatch: pytest.MonkeyPatch, hangs: bool
) -> None:
    """A camera that cannot be opened again after two frames, or that never returns, ends the stream after a while."""
    monkeypatch.setattr(stream_module, "_STALL_WARNING", 0.1)
    monkeypatch.setattr(stream_module, "_HANGING", 0.1)
    pictures, released, calls = iter([frame(), frame()]), threading.Event(), 0

    def grab() -> Any:
        if hangs and not pictures.__length_hint__():
            released.wait(60)
        return next(pictures)  # a broken adapter raises StopIteration after two frames

    def make() -> Any:
        nonlocal calls
        calls += 1
        if calls > 1:
            raise OSError("no camera")
        return grab

    ended = stream.run(*stream.camera(make), "--policy", "every", "--give-up", "0.4")
    released.set()
    assert ended.code == 2
    assert "no frame for" in ended.said
    assert ("stall" in [event["event"] for event in ended.results.events]) or "OSError: no camera" in ended.said
    assert len(ended.results.records) == 2


def test_a_signal_ends_the_stream_with_whole_results(stream: Stream) -> None:
    count = 0

    def grab() -> Any:
        nonlocal count
        count += 1
        if count == 20:
            os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.001)
        return frame()

    ended = stream.run(*stream.camera(lambda: grab), "--policy", "every")
    assert ended.code == 143
    assert ended.summary["processed"] == ended.summary["frames_in"] == len(ended.results.records) >= 20


def test_the_last_record_may_be_cut(stream: Stream) -> None:
    stream.run(*stream.recorded(5))
    path = stream.folder / "results" / "records.bin"
    path.write_bytes(path.read_bytes()[:-1])
    (stream.folder / "results" / "events.jsonl").write_text('{"event": "restart"}\n{"eve')
    cut = player.read_results(stream.folder / "results")
    np.testing.assert_array_equal(cut.records["frame"], np.arange(4))
    assert cut.events == [{"event": "restart"}]


def test_a_table_of_the_scalars_and_no_overwriting(stream: Stream) -> None:
    stream.run(*stream.recorded(5))
    table = stream.folder / "table.csv"
    player.write_table(stream.folder / "results", table)
    lines = table.read_text(encoding="utf-8").splitlines()
    assert lines[0] == (
        "frame,time (s),latency (ms),frame_status,key_frame,restart,contact_threshold,"
        "real_contact_area (mm²),gross_contact_area (mm²),ellipse_center_x (mm),ellipse_center_y (mm),"
        "ellipse_semi_axes_major (mm),ellipse_semi_axes_minor (mm),ellipse_angle (°),illumination_gain,"
        "median_divergence (µm/mm),median_divergence_std (µm/mm),median_curl (µm/mm),median_curl_std (µm/mm),"
        "median_strain_exx (µm/mm),median_strain_eyy (µm/mm),median_strain_exy (µm/mm),"
        "median_strain_std_exx (µm/mm),median_strain_std_eyy (µm/mm),median_strain_std_exy (µm/mm),"
        "global_displacement_vector_x (µm),global_displacement_vector_y (µm),"
        "global_displacement_vector_std_x (µm),global_displacement_vector_std_y (µm),"
        "global_displacement (µm),global_displacement_std (µm),slip_flag"
    )
    assert [float(line.split(",")[0]) for line in lines[1:]] == [0, 1, 2, 3, 4]
    with pytest.raises(FingerflowError, match="exists"):
        player.write_table(stream.folder / "results", table)
    again = stream.run(*stream.recorded(2))
    assert (again.code, len(again.results.records)) == (2, 5)
    assert "exists already" in again.said
