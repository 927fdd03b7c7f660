"""What a stream does with its frames: policies, key frames, restarts, errors of the source, results."""

import json
import math
import os
import signal
import threading
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Stream
from tiny_bundle import HEIGHT, POINTS, WIDTH, frame, write_bundle

from fingerflow import player
from fingerflow.player import stream as stream_module
from fingerflow.player.handover import Channel, Slot
from fingerflow.player.latency import Latencies
from fingerflow.player.motion import Motion
from fingerflow.player.sources.synthetic import Synthetic, side_by_side
from fingerflow.player.stepper import Stepper
from fingerflow.player.upkeep import ThresholdSearch, Upkeep


def test_a_recording_gives_one_record_a_frame(stream: Stream) -> None:
    frames = np.stack([frame(contact_px=10 * number) for number in range(40)])
    np.save(stream.folder / "frames.npy", frames)
    ended = stream.run("--source", str(stream.folder / "frames.npy"), "--json", str(stream.folder / "summary.json"))
    assert ended.code == 0
    assert (ended.summary["frames_in"], ended.summary["processed"], ended.summary["dropped"]) == (40, 40, 0)
    assert json.loads((stream.folder / "summary.json").read_text()) == ended.summary
    records, header, events = ended.results
    np.testing.assert_array_equal(records["frame"], np.arange(40))
    np.testing.assert_array_equal(records["real_contact_area"], np.arange(40) * 10 * 0.5**2)  # mm_per_px is 0.5
    np.testing.assert_array_equal(records["divergence"], np.arange(40)[:, None].repeat(POINTS, 1))  # the state goes on
    np.testing.assert_array_equal(records["ellipse_center"], np.broadcast_to((WIDTH / 4, HEIGHT / 4), (40, 2)))
    np.testing.assert_array_equal(records["position_px"][:, 3], np.broadcast_to((9.0, 8.0), (40, 2)))
    np.testing.assert_array_equal(records["status"], 1)
    assert (records["latency"] > 0).all()
    assert "real_contact_mask" not in (records.dtype.names or ())
    units = {field["name"]: field["unit"] for field in header["fields"]}
    assert (units["real_contact_area"], units["forward_backward_error"]) == ("mm2", "px")
    assert [event["event"] for event in events] == ["restart"]


def test_a_raw_file_and_a_video_give_the_same(stream: Stream) -> None:
    cv2 = pytest.importorskip("cv2")
    frames = [frame(contact_px=100 * number) for number in range(4)]
    np.stack(frames).tofile(stream.folder / "frames.raw")
    size = (2 * WIDTH, HEIGHT)
    video = cv2.VideoWriter(str(stream.folder / "frames.avi"), cv2.VideoWriter_fourcc(*"FFV1"), 30, size, False)
    if not video.isOpened():
        pytest.skip("this OpenCV cannot write a lossless video")
    for picture in frames:
        video.write(picture)
    video.release()
    raw = stream.run("--source", str(stream.folder / "frames.raw"), "--shape", str(HEIGHT), str(2 * WIDTH))
    areas = np.array(raw.results.records["real_contact_area"])
    (stream.folder / "results").rename(stream.folder / "raw")
    played = stream.run("--source", str(stream.folder / "frames.avi"))
    np.testing.assert_array_equal(areas, np.arange(4) * 25)
    np.testing.assert_array_equal(played.results.records["real_contact_area"], areas)


class Slow:
    """A graph that takes its time."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
        run = Stepper.run

        def slow(*arguments: Any) -> None:
            time.sleep(seconds)
            run(*arguments)

        monkeypatch.setattr(Stepper, "run", slow)


def test_the_policy_every_loses_nothing(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    """A paced source that is twice as fast as the graph: it waits, and that is counted."""
    Slow(monkeypatch, 0.004)
    ended = stream.run("--source", "synthetic", "--rate", "500", "--frames", "120", "--queue", "4")
    np.testing.assert_array_equal(ended.results.records["frame"], np.arange(120))
    assert ended.summary["dropped"] == 0
    assert ended.summary["overruns"] > 0
    # Waiting counts as latency: it is measured from when a camera would have given the frame.
    assert ended.results.records["latency"][-1] > 0.1


def test_the_policy_latest_takes_the_newest_frame(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    Slow(monkeypatch, 0.004)
    ended = stream.run("--source", "synthetic", "--rate", "500", "--frames", "120", "--policy", "latest")
    summary, numbers = ended.summary, ended.results.records["frame"]
    assert summary["frames_in"] == 120
    assert summary["dropped"] > 0
    assert summary["processed"] + summary["dropped"] == 120
    assert len(numbers) == summary["processed"]
    assert (np.diff(numbers) > 0).all()
    assert numbers[-1] == 119
    assert summary["overruns"] == 0


#: Found in a stream with a new key frame (7 of 10 four times) and a restart (4 of 10 four times).
FOUND = [10] * 4 + [7] * 6 + [6] * 2 + [4] * 4 + [10] * 6


@pytest.mark.parametrize(("parallel", "lag"), [("1", 2), ("2", 2), ("3", 3)])
def test_frames_side_by_side(stream: Stream, monkeypatch: pytest.MonkeyPatch, parallel: str, lag: int) -> None:
    """Every frame in its order with its own result; key frame and restart count from a frame known beforehand."""
    monkeypatch.setattr(Upkeep, "_RESTART", 0)
    frames = [frame(found=number) for number in FOUND]
    ended = stream.run(*stream.frames(frames), "--policy", "every", "--parallel-frames", parallel)
    records, events = ended.results.records, ended.results.events
    number = np.arange(len(FOUND))
    np.testing.assert_array_equal(records["frame"], number)
    assert [(event["event"], event["frame"]) for event in events] == [("restart", 0), ("key_frame", 7), ("restart", 15)]
    np.testing.assert_array_equal(records["key_frame"], np.select([number < 7 + lag, number < 15 + lag], [0, 7], 15))
    np.testing.assert_array_equal(records["restart"], np.where(number < 15 + lag, 1, 2))
    # Points lost before the key frame are not in it, until others are chosen.
    most = np.where((number >= 7 + lag) & (number < 15 + lag), 7, 10)
    np.testing.assert_array_equal(np.isfinite(records["position_px"][..., 0]).sum(1), np.minimum(FOUND, most))


@pytest.mark.parametrize(
    ("parallel", "arguments"), [("1", ("--rate", "1500")), ("2", ()), ("2", ("--rate", "1500"))], ids=str
)
def test_results_do_not_depend_on_the_clock(
    stream: Stream, monkeypatch: pytest.MonkeyPatch, parallel: str, arguments: tuple[str, ...]
) -> None:
    """Bit for bit the same, whatever the pace, the frames side by side and the time that each takes."""
    monkeypatch.setattr(Upkeep, "_RESTART", 10)
    stream.scene.write_text(stream.scene.read_text().replace("threshold = 0.5", ""))
    generator = np.random.default_rng(5)
    found = FOUND + [10] * 20 + FOUND * 3
    moved = np.cumsum(generator.integers(-3, 4, len(found))).clip(-60, 60)
    stale = generator.integers(0, 5, len(found)).tolist()
    given = zip(found, moved.tolist(), stale, strict=True)
    frames = np.stack([frame(one, 4 * i % 700, *others) for i, (one, *others) in enumerate(given)])
    np.save(stream.folder / "frames.npy", frames)
    source = ("--source", str(stream.folder / "frames.npy"))
    plain = stream.run(*source)
    assert len(plain.results.events) > 6
    (stream.folder / "results").rename(stream.folder / "plain")
    run = Stepper.run

    def uneven(stepper: Stepper, side: int) -> None:
        time.sleep(float(generator.choice((0, 0, 0, 0.004))))
        run(stepper, side)

    monkeypatch.setattr(Stepper, "run", uneven)
    other = stream.run(*source, "--parallel-frames", parallel, *arguments)
    reference = player.read_results(stream.folder / "plain").records
    assert np.ptp(reference["expected"][:, 0]) > 5
    for name in set(reference.dtype.names or ()) - {"time", "latency"}:
        assert other.results.records[name].tobytes() == reference[name].tobytes(), name
    said = [[(e["event"], e["frame"]) for e in events] for events in (plain.results.events, other.results.events)]
    assert said[0] == said[1]


def test_frames_side_by_side_run_at_the_same_time(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each frame runs until two others do."""
    run, started = Stepper.run, threading.Barrier(3)

    def together(stepper: Stepper, side: int) -> None:
        if stepper.found:  # not while it warms up
            started.wait(timeout=60)
        run(stepper, side)

    monkeypatch.setattr(Stepper, "run", together)
    frames = [frame(contact_px=number) for number in range(9)]
    ended = stream.run(*stream.frames(frames), "--policy", "every", "--parallel-frames", "3")
    np.testing.assert_array_equal(ended.results.records["real_contact_area"], np.arange(9) / 4)


@pytest.mark.parametrize("failing", [0, 1, 2])
def test_a_frame_that_fails_ends_the_stream_with_all_before_it(
    stream: Stream, monkeypatch: pytest.MonkeyPatch, failing: int
) -> None:
    """Also where it fails before those have ended."""
    begin, run, failed = Stepper.begin, Stepper.run, threading.Event()
    sides: list[int] = []

    def note(stepper: Stepper, slot: Slot, measure: bool = False) -> int:
        sides.append(begin(stepper, slot, measure))
        return sides[-1]

    def fail(stepper: Stepper, side: int) -> None:
        run(stepper, side)
        if not stepper.found:  # it warms up
            sides.clear()
        elif sides.index(side) == failing:
            failed.set()
            raise RuntimeError("broken graph")
        else:
            assert failed.wait(timeout=60)

    monkeypatch.setattr(Stepper, "begin", note)
    monkeypatch.setattr(Stepper, "run", fail)
    with pytest.raises(RuntimeError, match="broken graph"):
        stream.run(*stream.frames(frame() for _ in range(9)), "--policy", "every", "--parallel-frames", "3")
    results = stream.folder / "results"
    assert results.is_dir() == (failing > 0)  # an empty folder is not left
    if failing:
        np.testing.assert_array_equal(player.read_results(results).records["frame"], np.arange(failing))


def _darkened(level: int) -> Any:
    picture = frame()
    picture[2:6, WIDTH + 2 : WIDTH + 8] = level
    return picture


@pytest.mark.parametrize("setting", ["", 'threshold = "reference_frame"'])
def test_a_threshold_that_is_not_given_is_measured(stream: Stream, setting: str) -> None:
    """Of the first of every four frames that shows contact: 0.4 of the light, half of what it loses. It counts two
    frames later, and darker ones keep it."""
    stream.scene.write_text(stream.scene.read_text().replace("threshold = 0.5", setting))
    levels = (200, 40, 40, 40, 40, 40, 40, 10, 130, 10)
    np.save(stream.folder / "frames.npy", np.stack([_darkened(level) for level in levels]))
    ended = stream.run("--source", str(stream.folder / "frames.npy"))
    np.testing.assert_array_equal(ended.results.records["real_contact_area"], [0, 0, 0, 0, 0, 0, 6, 6, 0, 6])
    [event] = [event for event in ended.results.events if event["event"] == "threshold"]
    assert event["frame"] == 4
    assert event["threshold"] == pytest.approx(0.4, abs=1e-6)
    assert ended.summary["threshold"] == event["threshold"]
    assert ended.results.header["threshold"] == "measured"
    assert "frame 4: threshold 0.4000" in ended.said


def test_a_threshold_below_no_light_is_refused(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    """A graph that finds one in frames brighter than the empty glass."""
    run = Stepper._run

    def wrong(stepper: Stepper, graph: str, given: Any) -> Any:
        found = run(stepper, graph, given)
        return found | {"threshold": np.array([-0.127])} if graph == "contact" else found

    monkeypatch.setattr(Stepper, "_run", wrong)
    stream.scene.write_text(stream.scene.read_text().replace("threshold = 0.5", ""))
    ended = stream.run(*stream.frames(_darkened(40) for _ in range(12)), "--policy", "every")
    assert ended.summary["threshold"] is None
    np.testing.assert_array_equal(ended.results.records["real_contact_area"], 0)


def test_a_restart_measures_the_threshold_again(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    """The old one stays in use until the next is found."""
    monkeypatch.setattr(Upkeep, "_RESTART", 0)
    stream.scene.write_text(stream.scene.read_text().replace("threshold = 0.5", ""))
    frames = [_darkened(40) for _ in range(4)] + [_darkened(110) for _ in range(12)]
    for picture in frames[4:8]:  # points are lost: others are chosen in frame 7 and followed from 9 on
        picture[0, 0] = 0
    ended = stream.run(*stream.frames(frames), "--policy", "every")
    # 0.45 of intensity lost is over 0.4; measured again in frame 12, the half of it.
    found = [(event["frame"], event["threshold"]) for event in ended.results.events if event["event"] == "threshold"]
    assert found == [(0, pytest.approx(0.4, abs=1e-6)), (12, pytest.approx(0.225, abs=1e-6))]
    assert [event["frame"] for event in ended.results.events if event["event"] == "restart"] == [0, 7]
    np.testing.assert_array_equal(ended.results.records["real_contact_area"], [0, 0] + [6] * 14)


def test_a_growing_contact_measures_the_threshold_again() -> None:
    """Where it had grown by a fourth since the threshold counts, two frames later; and so on."""
    search = ThresholdSearch(2)
    used, measured = {}, []
    for index in range(40):
        threshold = search.due(index)
        if threshold is not None:
            search.used()
            used[index] = threshold
        if search.wants(index):
            measured.append(index)
        area = max(0.0, index - 5)
        search.see(index, area, (0.2 + index / 100 if area else math.nan) if index in measured else None)
    assert measured[:3] == [0, 4, 8]
    # The threshold counts from 10 on, where the area is 5: beyond 6.25 in frame 12, measured in 14, counts from 16 on.
    assert measured[3:6] == [14, 21, 30]
    assert list(used.items())[:3] == [(10, pytest.approx(0.28)), (16, pytest.approx(0.34)), (23, pytest.approx(0.41))]


def test_a_contact_that_gives_no_better_threshold_keeps_the_old_one() -> None:
    search = ThresholdSearch(2)
    assert search.see(0, 1.0, 0.3)
    assert (search.due(1), search.due(2)) == (None, 0.3)
    search.used()
    assert not search.see(2, 10.0, None)
    assert not search.see(3, 20.0, None)
    assert [search.wants(index) for index in (4, 5, 6)] == [False, True, False]
    assert not search.see(5, 20.0, math.nan)
    assert not search.see(6, 24.0, None)
    assert not search.wants(8)
    assert not search.see(7, 26.0, None)
    assert search.wants(9)


def test_points_are_keyed_anew_and_chosen_anew(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Upkeep, "_RESTART", 0)
    frames = [frame(found=found, moved=4 * (k > 0)) for k, found in enumerate(FOUND)]
    ended = stream.run(*stream.frames(frames), "--policy", "every")
    records, number = ended.results.records, np.arange(len(FOUND))
    # `error` is the pixel of the key frame: what `key` gave is held until it runs again.
    np.testing.assert_array_equal(
        records["forward_backward_error"][:, 0], np.select([number < 9, number < 17], [10, 7], 4)
    )
    assert np.isnan(records["started"][9:17, 7:]).all()  # points lost before the key frame are not in it
    np.testing.assert_array_equal(records["divergence"][:, 0], np.where(number < 17, number, number - 17))
    # Points that have moved are compared with a key frame, and stay those that were chosen.
    assert np.isfinite(records["started"][9:17, 0]).all()
    assert (records["started"][9:17, 0] != records["started"][0, 0]).all()
    np.testing.assert_array_equal(records["curl"], np.broadcast_to(records["started"][0], records["curl"].shape))
    events = [(event["event"], event["frame"], event["points"]) for event in ended.results.events]
    assert events == [("restart", 0, 10), ("key_frame", 7, 7), ("restart", 15, 10)]


@pytest.mark.parametrize("parallel", ["1", "2"])
def test_stale_templates_are_renewed(stream: Stream, parallel: str) -> None:
    """Looked at after every eighth frame, in pieces of four points; they count eight frames later, those under way are
    not asked for again, and none counts after a new key frame: that is 27, where 7 of 10 points are found for the
    fourth time."""
    stale = {7: 6, 15: 8, 23: 1}
    found = [10] * 24 + [7] * 16
    frames = [frame(found=count, stale=stale.get(number, 0)) for number, count in enumerate(found)]
    ended = stream.run(*stream.frames(frames), "--policy", "every", "--parallel-frames", parallel)
    records, number = ended.results.records, np.arange(len(found))
    assert [event["frame"] for event in ended.results.events if event["event"] == "key_frame"] == [27]
    assert "stale" not in (records.dtype.names or ())
    assert "warp" not in (records.dtype.names or ())
    start = records["position_px"][0, :, 0]
    moved = records["position_px"][..., 0] - start
    np.testing.assert_array_equal(moved[:, 0], np.where(number < 16, 0, 1))
    np.testing.assert_array_equal(moved[:, 5], np.where(number < 16, 0, 1))
    np.testing.assert_array_equal(moved[:, 6], np.where(number < 24, 0, 1))


def test_a_renewal_that_fails_ends_the_stream(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    """In whatever thread: none waits for it."""
    run, asked = Stepper._run, []

    def failing(stepper: Stepper, graph: str, given: Any) -> Any:
        asked.append(graph)
        if asked.count("renew") > 2:  # two warm up
            raise MemoryError("no room")
        return run(stepper, graph, given)

    monkeypatch.setattr(Stepper, "_run", failing)
    frames = [frame(stale=6 if number == 7 else 0) for number in range(32)]
    with pytest.raises(MemoryError, match="no room"):
        stream.run(*stream.frames(frames), "--policy", "every", "--parallel-frames", "2")


def test_single_frames_change_nothing() -> None:
    """Nor do four that are not in a row; lost points are chosen anew, and not again at once."""
    upkeep = Upkeep(0.8, math.inf)
    upkeep.restarted(0, 0, 100)
    tracked = [100, 10, 100, 10, 10, 10, 100, 70, 70, 70, 100]
    assert [upkeep.see(i, i, count) for i, count in enumerate(tracked)] == [""] * len(tracked)
    assert [upkeep.see(i, i, 70) for i in range(4)] == ["", "", "", "rekey"]
    upkeep.keyed(3, 70)
    assert [upkeep.see(i, i, 40) for i in range(4, 8)] == ["", "", "", "rekey"]
    upkeep.keyed(7, 40)
    assert {upkeep.see(i, i, 0) for i in range(8, 64)} == {""}
    assert upkeep.see(64, 64, 0) == "lost"
    upkeep.kept(66)
    assert {upkeep.see(i, i, 0) for i in range(67, 130)} == {""}
    assert upkeep.see(130, 130, 0) == "lost"


def test_a_restart_that_finds_nothing_is_not_kept(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    """Points that are covered for a while are found again: they are the same as before."""
    monkeypatch.setattr(Upkeep, "_RESTART", 0)
    black = frame(found=0)
    black[:, :WIDTH] = 0
    frames = [frame()] * 4 + [black] * 10 + [frame()] * 10
    ended = stream.run(*stream.frames(frames), "--policy", "every")
    events = [(event["event"], event["frame"]) for event in ended.results.events]
    assert events == [("restart", 0), ("not_usable", 4)]
    # The first three could be frames of another moment; the fourth is what there is now.
    np.testing.assert_array_equal(np.flatnonzero(ended.results.records["frame_status"]), [4, 5, 6])
    np.testing.assert_array_equal(
        np.isfinite(ended.results.records["position_px"][..., 0]).sum(1), [10] * 4 + [0] * 10 + [10] * 10
    )


def test_a_scene_may_key_by_number_and_limit_the_region(stream: Stream) -> None:
    text = stream.scene.read_text()
    stream.scene.write_text(f"{text}[stream]\nrekey_frames = 3\nregion = {{rows = [0, 5], columns = [2, 9]}}\n")
    ended = stream.run(*stream.frames(frame() for _ in range(8)), "--policy", "every")
    np.testing.assert_array_equal(ended.results.records["key_frame"], [0, 0, 0, 0, 0, 3, 3, 3])
    dark = frame()
    dark[:5, 2:9] = 0
    (stream.folder / "results").rename(stream.folder / "first")
    ended = stream.run(*stream.frames([dark] * 3), "--policy", "every")
    assert [event["points"] for event in ended.results.events] == [0]  # nothing to see in the region


def test_a_source_that_fails_is_opened_again(stream: Stream) -> None:
    frames = [frame(), frame(), OSError("cable"), OSError("cable"), frame(), frame()]
    ended = stream.run(*stream.frames(frames), "--policy", "every")
    assert ended.code == 0
    assert (ended.summary["processed"], ended.summary["reconnects"]) == (4, 2)
    assert "OSError: cable" in ended.said
    assert sorted(event["event"] for event in ended.results.events) == ["reconnect", "reconnect", "restart"]


def test_a_source_that_stays_away_ends_the_stream(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream_module, "_STALL_WARNING", 0.1)
    calls = 0

    def make() -> Any:
        nonlocal calls
        calls += 1
        if calls > 1:
            raise OSError("no camera")
        return iter([frame(), frame()]).__next__  # StopIteration after two: a broken adapter

    ended = stream.run(*stream.camera(make), "--policy", "every", "--give-up", "0.5")
    assert ended.code == 2
    assert "no frame for" in ended.said
    assert "OSError: no camera" in ended.said
    assert len(ended.results.records) == 2


def test_a_camera_that_hangs_ends_the_stream(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream_module, "_STALL_WARNING", 0.1)
    monkeypatch.setattr(stream_module, "_HANGING", 0.1)
    released = threading.Event()
    pictures = iter([frame(), frame()])

    def grab() -> Any:
        return next(pictures, None) if pictures.__length_hint__() else released.wait(60) or None

    ended = stream.run(*stream.camera(lambda: grab), "--policy", "every", "--give-up", "0.4")
    released.set()
    assert ended.code == 2
    assert "no frame for" in ended.said
    assert len(ended.results.records) == 2
    assert "stall" in [event["event"] for event in ended.results.events]


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
    ended = stream.run("--source", "synthetic", "--frames", "5")
    path = stream.folder / "results" / "records.bin"
    path.write_bytes(path.read_bytes()[:-1])
    (stream.folder / "results" / "events.jsonl").write_text('{"event": "restart"}\n{"eve')
    cut = player.read_results(stream.folder / "results")
    np.testing.assert_array_equal(cut.records["frame"], np.arange(4))
    assert cut.events == [{"event": "restart"}]
    del cut, ended  # Windows keeps mapped files
    path.write_bytes(b"")
    assert len(player.read_results(stream.folder / "results").records) == 0


def test_a_table_of_the_scalars(stream: Stream) -> None:
    stream.run("--source", "synthetic", "--frames", "5")
    table = stream.folder / "table.csv"
    player.write_table(stream.folder / "results", table)
    lines = table.read_text().splitlines()
    assert lines[0] == (
        "frame,time (s),latency (s),frame_status (1),key_frame (1),restart (1),contact_threshold (1),"
        "real_contact_area (mm2),ellipse_center_x (mm),ellipse_center_y (mm)"
    )
    assert [float(line.split(",")[0]) for line in lines[1:]] == [0, 1, 2, 3, 4]
    with pytest.raises(player.PlayerError, match="exists"):
        player.write_table(stream.folder / "results", table)


def test_results_are_never_overwritten(stream: Stream) -> None:
    stream.run("--source", "synthetic", "--frames", "5")
    again = stream.run("--source", "synthetic", "--frames", "2")
    assert again.code == 2
    assert "exists already" in again.said
    assert len(again.results.records) == 5


def test_frames_of_twelve_bits(stream: Stream, tmp_path: Path) -> None:
    stream.bundle = write_bundle(tmp_path / "deep", bit_depth=12)
    assert stream.run("--source", "synthetic", "--frames", "5").code == 0


def test_the_synthetic_finger_moves_smoothly_and_grows() -> None:
    scene = side_by_side(64, 80)
    source = Synthetic(scene, np.dtype(np.uint8), 8)
    frames = [np.array(source.read(), dtype=float) for _ in range(2 * source.half_period)]
    dark = [(scene.contact.crop(picture) < 130).sum() for picture in frames]
    assert dark[0] == dark[2 * source.half_period - 2] > 0
    assert dark[source.half_period - 1] > 2 * dark[0]
    assert max(np.abs(after - before).mean() for before, after in pairwise(frames)) < 12
    assert scene.topography.crop(frames[0]).std() > 10


def test_latencies_are_kept_in_bins() -> None:
    latencies = Latencies()
    assert latencies.summary()["median"] is None
    times = np.linspace(0.001, 0.011, 1001)
    for seconds in times:
        latencies.add(seconds)
    assert latencies.quantile(0.5) == pytest.approx(0.006, rel=0.011)
    assert latencies.quantile(0.99) == pytest.approx(0.0109, rel=0.011)
    latencies.add(100.0)
    assert latencies.summary()["worst"] == 1e5


def test_openvino_gives_the_same(stream: Stream) -> None:
    """A provider with memory of its own, which copies what is bound: states and held tensors must not be stale."""
    pytest.importorskip("onnxruntime_ep_openvino", reason="the package onnxruntime-ep-openvino is not installed")
    stream.run("--source", "synthetic", "--frames", "30", "--provider", "cpu")
    (stream.folder / "results").rename(stream.folder / "cpu")
    ended = stream.run("--source", "synthetic", "--frames", "30", "--provider", "openvino")
    assert ended.results.header["provider"] == "OpenVINOExecutionProvider"
    cpu = player.read_results(stream.folder / "cpu").records
    for name in set(cpu.dtype.names or ()) - {"time", "latency"}:
        np.testing.assert_allclose(ended.results.records[name], cpu[name], rtol=1e-6, err_msg=name)


def _moving() -> tuple[Motion, Any, Any]:
    """Four points that have moved for 60 frames, of which every third was seen, and one that is none."""
    start = np.array([[[10, 20], [30, 40], [50, 60], [70, 80], [np.nan, np.nan]]], np.float32)
    speed = np.array([[[1, 0], [2, -1], [0.5, -3], [0, 0], [0, 0]]], np.float32)
    motion = Motion.at_rest(start, 7)
    np.testing.assert_array_equal(motion.expect(9), start)
    for frames in range(0, 61, 3):
        motion = motion.see(start + frames * speed, 7 + frames)
    return motion, start + 60 * speed, speed


def test_points_are_expected_where_they_move() -> None:
    """Each at its own speed, up to 4 frames ahead."""
    motion, place, speed = _moving()
    for ahead, frames in ((0, 0), (1, 1), (4, 4), (5, 4), (100, 4)):
        assert motion.expect(67 + ahead).dtype == np.float32
        np.testing.assert_allclose(motion.expect(67 + ahead), place + frames * speed, rtol=1e-5)


def test_lost_points_go_on_and_come_to_rest() -> None:
    motion, place, speed = _moving()
    seen = place + speed
    seen[0, 1] = np.nan
    motion = motion.see(seen, 68)
    np.testing.assert_allclose(motion.expect(68), place + speed, rtol=1e-5)
    for frames in range(2, 60):
        motion = motion.see(np.full_like(place, np.nan), 67 + frames)
    rest = place + speed + 4 * speed  # 1 + 3/4 + 9/16 ...
    rest[0, 1] -= speed[0, 1]  # a frame before the others
    np.testing.assert_allclose(motion.expect(130), rest, rtol=1e-5)
    motion = motion.see(rest + 0.8, 130)  # found beside: that is no motion
    np.testing.assert_allclose(motion.expect(134), rest + 0.8, rtol=1e-5)
    motion = motion.without(seen)
    np.testing.assert_allclose(motion.expect(134)[0, [0, 2, 3]], (rest + 0.8)[0, [0, 2, 3]], rtol=1e-5)
    assert np.isnan(motion.expect(134)[0, [1, 4]]).all()


def test_noise_is_not_taken_for_motion() -> None:
    """What is expected 4 frames ahead has weights 3, -1, -1/2, -1/4 ... of the positions, and 3.2 times their noise; by
    the last two positions alone it would have weights 5 and -4, and 6.4 times."""
    generator = np.random.default_rng(3)
    start = np.full((1, 5000, 2), 100.0)
    motion = Motion.at_rest(start, 0)
    for number in range(12):
        motion = motion.see(start + 0.05 * generator.standard_normal(start.shape), number)
    assert np.std(motion.expect(100) - start) < 3.5 * 0.05


@pytest.mark.parametrize(("newest_first", "order"), [(False, [1, 2, 3]), (True, [3, 2, 1])])
def test_a_closed_channel_still_gives_what_is_in_it(newest_first: bool, order: list[int]) -> None:
    channel = Channel(3, [1, 2], newest_first)
    assert channel.put(3)
    channel.close()
    assert not channel.put(4)
    assert [channel.get() for _ in range(4)] == [*order, None]
    assert channel.is_empty()
