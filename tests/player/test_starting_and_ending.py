"""Tests of a stream that cannot start, which leaves nothing behind, and of how a stream ends whatever its
camera does.
"""

import json
import shutil
import socket
import threading
from typing import Any

import numpy as np
import pytest
from tiny_bundle import HEIGHT, WIDTH, Stream, frame

from fingerflow.player import stream_player as stream_module


def test_a_start_that_fails_leaves_no_results(stream: Stream) -> None:
    def no_camera() -> Any:
        raise OSError("no such camera")

    for shape in ((64, 192, 3), (64, 192, 4), (1, 64, 192)):
        assert "of a colour camera; set it to grey" in stream.refused(*stream.frames([np.zeros(shape, np.uint8)]))
    assert "frame 0 is (64, 96)" in stream.refused(*stream.frames([np.zeros((HEIGHT, WIDTH), np.uint8)]))
    assert "cannot be opened (OSError: no such camera)" in stream.refused(*stream.camera(no_camera))
    ended = stream.run(*stream.frames([]))
    assert (ended.code, ended.results, ended.summary["results"]) == (0, None, None)
    assert ended.summary["warnings"][0].startswith("no frame could be measured (none came)")


def test_a_page_that_cannot_be_served_leaves_no_results_and_closes_the_camera(stream: Stream) -> None:
    closed = threading.Event()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        said = stream.refused(*stream.camera(lambda: _Camera(closed.set)), "--page", str(taken.getsockname()[1]))
    assert "cannot be served" in said
    assert closed.is_set()


class _Camera:
    """A camera with two frames and then the end, or an error; `close` is given by the test."""

    def __init__(self, close: Any, then: Exception | None = None) -> None:
        self.close, self._then = close, then
        self._left = [frame(), frame()]

    def __call__(self) -> Any:
        if self._left:
            return self._left.pop()
        if self._then is not None:
            raise self._then
        return None


def test_a_camera_that_fails_and_never_closes_is_opened_again(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream_module, "_HANGING", 0.1)
    never, made = threading.Event(), 0

    def make() -> Any:
        nonlocal made
        made += 1
        return _Camera(never.wait, OSError("cable") if made == 1 else None)

    ended = stream.run(*stream.camera(make), "--policy", "every")
    never.set()
    assert (ended.code, made) == (0, 2)
    assert len(ended.results.records) == 4
    assert "it is left behind" in ended.said


def test_a_camera_may_say_whether_it_has_a_frame(stream: Stream) -> None:
    """A camera may give pairs (has a frame, frame), as `read` of OpenCV does; it is opened again if it has no frame, as
    after an error.
    """
    frames = [(True, frame()), (np.True_, frame()), (False, None), (True, frame())]
    ended = stream.run(*stream.frames(frames), "--policy", "every")
    assert (ended.code, len(ended.results.records), ended.summary["reconnects"]) == (0, 3, 1)
    assert "the camera gave (False, ...)" in ended.said


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (frame().tolist(), "gave a list in place of a frame"),
        ((frame(), "3"), "gave a frame with the time stamp '3' in place of a frame"),
        ((frame(), 10**400), "gave a frame with the time stamp 1000"),
    ],
)
def test_what_is_no_frame_is_refused_in_words(stream: Stream, given: Any, said: str) -> None:
    refusal = stream.refused(*stream.frames([given]), "--policy", "every")
    assert said in refusal
    assert "numpy.asarray" in refusal


def test_a_summary_replaces_summaries_alone(stream: Stream) -> None:
    """A file that is no summary of a stream is not replaced by the summary: the stream is refused before its first
    frame.
    """
    path = stream.folder / "summary.json"
    path.write_text('{"participants": 16}')
    ended = stream.run(*stream.frames([frame()]), "--json", str(path))
    assert ended.code == 2
    assert "summary.json: exists and is no summary of a stream; give --json another name" in ended.said
    assert path.read_text() == '{"participants": 16}'
    path.unlink()
    for count in (1, 2):
        ended = stream.run(*stream.frames([frame()] * count), "--policy", "every", "--json", str(path))
        assert ended.code == 0
        assert json.loads(path.read_text())["processed"] == count
        shutil.rmtree(stream.folder / "results")
