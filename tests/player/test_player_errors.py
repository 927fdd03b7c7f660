"""Tests of wrong scenes, bundles, frames and options: each is named, and no results are left where nothing ran."""

import hashlib
import json
import os
import shutil
import sys
import threading
from asyncio import CancelledError
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiny_bundle import HEIGHT, WIDTH, Stream, frame, write_bundle

from fingerflow.engines.bundle import load_bundle
from fingerflow.errors import FingerflowError
from fingerflow.player.stream_player import Player
from fingerflow.results.stream_folder import read_results

CALIBRATION = "mm_per_px = 0.5\ntopography_to_contact = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "rows = [0, 64]",
            "rows = [0, 63]",
            "views.contact of the scene is 63 x 96 px, the bundle was exported for 64",
        ),
        # A threshold measured once may not take the place of one for each frame.
        ("threshold = 0.5", 'threshold = "per_frame"', "known before it comes: give a number, such as 0.25, or"),
        # The graphs refer to onset: a stream would show another quantity under the same name.
        ("[contact]", "[fields]\nreference = 12\n[contact]", "fields.reference of the scene is 12; the graphs of"),
        ('frames = "empty.npy"', 'frames = "nothing.npy"', "scene.toml: frames of [background] is"),
        ("[contact]", "[stream]\nregion = {rows = [0, 99], columns = [0, 9]}\n[contact]", "ends beyond"),
        (CALIBRATION, 'file = "nothing.toml"', "nothing.toml does not exist"),
    ],
)
def test_a_wrong_scene_is_named(stream: Stream, old: str, new: str, said: str) -> None:
    """Scenes that a stream cannot play are refused in a sentence, as are examples of scenes that no reader takes
    (tests/schema/scene_cases.py has all of them).
    """
    text = stream.scene.read_text()
    assert old in text
    stream.scene.write_text(text.replace(old, new, 1))
    assert said in stream.refused(*stream.frames([frame()]))


def test_the_background_is_the_mean_of_its_first_frames(stream: Stream) -> None:
    """The background is the floating-point mean of the first 64 frames, as in `fingerflow process`. Row 5 has a mean of
    200.25 counts, so that its pixels of 100 counts have lost more than 0.5 of the light.
    """
    pictures = np.full((70, HEIGHT, 2 * WIDTH), 200, np.uint8)
    pictures[:16, 5] += 1
    pictures[64:] = 0  # frames after the first 64 are not used
    np.save(stream.bundle / "empty.npy", pictures)
    picture = frame()
    picture[5, WIDTH:] = 100
    [event] = stream.run(*stream.frames([picture])).results.records["real_contact_area"]
    assert event == WIDTH / 4


def test_the_frames_that_count(stream: Stream) -> None:
    """The recording of the scene is played in the range that the scene gives, with the numbers of its frames; every
    other source is played as a whole.
    """
    np.save(stream.bundle / "frames.npy", np.stack([frame(contact_px=number) for number in range(12)]))
    np.save(stream.bundle / "others.npy", np.stack([frame()] * 12))
    text = stream.scene.read_text()
    stream.scene.write_text(f'[recording]\nframes = "frames.npy"\nfirst_frame = 3\nlast_frame = 8\n{text}')
    for arguments, numbers in (
        (("--frames", "2"), np.arange(3, 5)),
        (("--source", str(stream.bundle / "frames.npy")), np.arange(3, 9)),
        (("--source", str(stream.bundle / "others.npy")), np.arange(12)),
    ):
        ended = stream.run(*arguments)
        np.testing.assert_array_equal(ended.results.records["frame"], numbers)
        if "others" not in "".join(arguments):
            np.testing.assert_array_equal(ended.results.records["real_contact_area"], numbers / 4)
        (stream.folder / "results").rename(stream.folder / f"results{len(list(stream.folder.iterdir()))}")


def test_settings_that_the_bundle_has_decided_otherwise_are_said(stream: Stream) -> None:
    """The log and the results name each setting of the scene that differs from the bundle in one sentence, and no
    setting that agrees; and an image scale that is none of a fingertip.
    """
    text = stream.scene.read_text()
    scene_text = """[tracking]
points = 700
window_px = 9
template = "previous"
[fields]
gauge_length_mm = 24.0
strain = "as_printed"
"""
    text = text.replace("mm_per_px = 0.5", "mm_per_px = 0.01")
    stream.scene.write_text(text + "median_px = 9\n" + scene_text)
    ended = stream.run(*stream.frames([frame()]))
    said = [
        "contact.median_px of the scene is 9; the bundle plays with 1",
        "tracking.points of the scene is 700; the bundle plays with 10",
        "tracking.template of the scene is 'previous'; the bundle plays with 'keyframe'",
        "fields.strain of the scene is 'as_printed'; the bundle plays with 'green_lagrange'",
        "calibration.mm_per_px = 0.01 makes the contact view 0.96 mm wide, those of fingertips are 2 to 100 mm wide: "
        "the scale is wrong, and lengths and areas with it; calibrate again",
    ]
    assert ended.code == 0
    assert sorted(ended.results.header["warnings"]) == sorted(said)
    assert all(sentence in ended.said for sentence in said)


def _rewritten(folder: Path, **changes: Any) -> None:
    facts = json.loads((folder / "bundle.json").read_text())
    (folder / "bundle.json").write_text(json.dumps(facts | changes))


def test_wrong_bundles_are_named(stream: Stream) -> None:
    file = stream.bundle / "track.onnx"
    whole = file.read_bytes()

    def said(*arguments: str) -> str:
        return stream.refused(*stream.recorded(1), *arguments)

    file.write_bytes(whole[:-3])
    assert "track.onnx: its SHA-256 is" in said()
    files = json.loads((stream.bundle / "bundle.json").read_text())["files"]
    _rewritten(stream.bundle, files=files | {"track.onnx": hashlib.sha256(whole[:-3]).hexdigest()})
    assert ".onnx: onnxruntime cannot load it" in said("--engine", "onnx")
    _rewritten(stream.bundle, files={"track.onnx": hashlib.sha256(whole[:-3]).hexdigest()})
    assert "without the graphs contact, threshold, noise," in said("--engine", "onnx")
    assert set(load_bundle(stream.bundle).files) == {"track"}  # the compiled library plays it
    _rewritten(stream.bundle, files={})
    assert "bundle.json: lists no file" in said()
    for name in ("../bundle/track.onnx", "/etc/passwd", "C:/x", "a\\b", "", "a/../b", "./track.onnx", "a\0b"):
        _rewritten(stream.bundle, files={name: "0"})
        assert "is no name of a file in its folder" in said()
    stream.bundle = write_bundle(stream.folder / "code")
    (stream.bundle / "my_camera.py").write_text("raise SystemExit")
    for package in ("json", "fingerflow"):
        (stream.bundle / package).mkdir()
    assert load_bundle(stream.bundle).files
    for name in ("any.so", "numpy.py", "json/__init__.py", "fingerflow/player.so"):
        (stream.bundle / name).write_text("raise SystemExit")
        assert f"{name}: is code that bundle.json does not list" in said()
        (stream.bundle / name).unlink()
    os.mkfifo(stream.bundle / "pipe")
    (stream.bundle / "large").open("wb").truncate(1 << 40)
    for name, problem in (("pipe", "is a pipe, not a file"), ("large", "more than any"), ("track.onnx", "has 0...")):
        _rewritten(stream.bundle, files={name: 0})
        assert problem in said()
    _rewritten(stream.bundle, recipe=None)
    assert "has no proper entry 'recipe'" in said()
    _rewritten(stream.bundle, format=1)
    assert "its format is '1', this player reads 10; use the player of the same bundle, or export it again" in said()
    (stream.bundle / "bundle.json").unlink()
    assert "name the folder that `fingerflow export` wrote" in said()


def test_hostile_bundles_end_in_a_sentence(stream: Stream) -> None:
    path = stream.bundle / "bundle.json"
    facts = json.loads(path.read_text())
    texts = ["", "[" * 100_000, "NaN", "[]", "null", "1" * 5000, '{"format": 10}', json.dumps(facts) * 2]
    values = (None, True, -1, 10**400, float("nan"), 1e308, "x" * 5000, "\ud800", [[]] * 99, {"a": {}})
    for table in (facts["recipe"], *(table for table in facts["recipe"].values() if table), facts):
        for name, value in list(table.items()):
            for table[name] in values:
                texts.append(json.dumps(facts))
            table[name] = value
    messages = []
    for text in texts:
        path.write_text(text)
        try:
            load_bundle(stream.bundle)
        except FingerflowError as error:
            messages.append(str(error))
    assert max(map(len, messages)) < 2000
    assert len(messages) > 0.9 * len(texts) > 200  # a few values are right
    path.write_bytes(b"{")
    os.truncate(path, 1 << 32)
    with pytest.raises(FingerflowError, match="has more than 67108864 bytes"):
        load_bundle(stream.bundle)


def test_an_engine_that_does_not_serve_is_named(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    """An error names the compiled library if it is asked for and computes other numbers of the built-in frame, or is
    absent; without a choice ONNX Runtime is tried, and the error names the package if it is missing.
    """
    expected = json.loads((stream.bundle / "bundle.json").read_text())["expected"]
    expected["numbers"]["real_area_px"] *= 1.01
    _rewritten(stream.bundle, expected=expected)
    said = stream.refused(*stream.recorded(1), "--engine", "native")
    assert "its numbers of the built-in frame are not the expected ones (real_area_px is off by 0.0099" in said
    monkeypatch.setattr("fingerflow.engines.choice.is_present", lambda: False)
    said = stream.refused(*stream.recorded(1), "--engine", "native")
    assert "--engine native: the compiled library is not there, is turned off, or is of another version" in said
    assert "onnxruntime cannot load it" in stream.refused(*stream.recorded(1))
    monkeypatch.setitem(sys.modules, "fingerflow.engines.sessions", None)
    said = stream.refused(*stream.recorded(1))
    assert "no engine serves here: native does not (the compiled library is not there" in said
    assert "pip install onnxruntime" in said


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (frame()[:-1], "frame 2 is (63, 192), the background or the frames before are (64, 192)"),
        (np.pad(frame(), 1), "frame 2 is (66, 194), the background or the frames before are (64, 192)"),
        (frame().T.copy(), "frame 2 is (192, 64)"),
        (np.dstack([frame()] * 3), "a frame is (64, 192, 3), not (H, W): of a colour camera"),
        (frame().astype(np.uint16), "a frame is uint16, the bundle takes uint8 (bit_depth 8)"),
    ],
)
def test_wrong_frames_are_named_and_lose_nothing(stream: Stream, wrong: Any, said: str) -> None:
    ended = stream.run(*stream.frames([frame(), frame(), wrong, frame()]), "--policy", "every")
    assert ended.code == 2
    assert said in ended.said
    assert len(ended.results.records) == 2


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, GeneratorExit, CancelledError])
def test_a_camera_that_ends_its_program_ends_the_stream(stream: Stream, error: type[BaseException]) -> None:
    def make() -> Any:
        given = iter([frame(), frame()])

        def grab() -> Any:
            if (shown := next(given, None)) is None:
                raise error
            return shown

        return grab

    ended = stream.run(*stream.camera(make), "--policy", "every")
    assert ended.code == 2
    assert f"ended the stream by {error.__name__}; return None after the last frame" in ended.said
    assert len(ended.results.records) == 2


@pytest.mark.parametrize(
    "lose",
    [
        shutil.rmtree,
        lambda results: results.rename(results.with_name("away")),
        lambda results: shutil.copytree(results.rename(results.with_name("away")), results),
        lambda results: (results / "header.json").unlink(),
    ],
    ids=["removed", "renamed", "replaced", "one file"],
)
def test_results_that_are_removed_while_playing_go_on_elsewhere(stream: Stream, lose: Callable[[Path], object]) -> None:
    results = stream.folder / "results"

    def make() -> Any:
        given = iter(range(4))

        def grab() -> Any:
            number = next(given, None)
            if number == 2:
                lose(results)
            return None if number is None else frame()

        return grab

    (stream.folder / "results-moved").mkdir()  # a name that is taken
    options = [*stream.camera(make), "--policy", "every", "--page", "off"]
    assert stream.play([str(stream.bundle), *options, "--output", str(results)]) == 0
    moved = read_results(stream.folder / "results-moved-2")
    assert list(moved.records["frame"]) == [0, 1, 2, 3]
    assert moved.events[-1]["event"] == "moved"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--source", "nothing.npy"), "nothing.npy: is no file"),
        ((), "no source: give --source"),
        (("--source", "FRAMES", "--camera", "a:b"), "exclude each other"),
        (("--camera", "no_such_module:make"), "no_such_module"),
        (("--camera", "time:time"), "gave float; it must return a callable"),
        (("--source", "FRAMES", "--engine", "onnx", "--provider", "tensorrt"), "'tensorrt' is not installed here; "),
        (("--source", "FRAMES", "--frames", "1", "--page", "999.1.1.1:80"), "cannot be served"),
        (("--source", "FRAMES", "--engine", "native", "--provider", "cpu"), "--provider is of ONNX"),
    ],
)
def test_wrong_options_are_named(stream: Stream, arguments: tuple[str, ...], said: str) -> None:
    _, frames = stream.recorded(1)
    assert said in stream.refused(*(frames if one == "FRAMES" else one for one in arguments))


@pytest.mark.parametrize(
    ("suffix", "said"), [("npy", "not a NumPy file"), ("raw", "needs --shape HEIGHT WIDTH"), ("avi", "OpenCV")]
)
def test_files_that_hold_no_frames_are_named(stream: Stream, suffix: str, said: str) -> None:
    (stream.folder / f"frames.{suffix}").write_bytes(b"12345")
    assert said in stream.refused("--source", str(stream.folder / f"frames.{suffix}"))


def test_no_frame_is_measured_behind_an_exception(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither of the two threads that measure goes on where the other has failed, in whichever order they run."""
    fails = list[int]()
    monkeypatch.setattr(Player, "_measure_outcomes", lambda player: fails.pop())
    player = Player.__new__(Player)
    player._measuring, player._unfinished = threading.Lock(), False
    with pytest.raises(IndexError):
        player._measure_unless_failed()
    player._measure_unless_failed()  # which would raise
