"""Tests of the rule by which the live page says that results fall behind the camera."""

import re
import time
from typing import Any

import pytest
from conftest import Stream
from tiny_bundle import frame

from fingerflow import player
from fingerflow.player.keeping_up import KeepingUp
from fingerflow.player.stream_player import Player
from fingerflow.tracker.frame_tracker import StreamTracker


@pytest.mark.parametrize(
    ("age", "trailing", "lost", "median", "said"),
    [
        (0.01, 3, (0, 0), 4.0, ""),
        (0.4, 5, (0, 0), 4.0, "0.4 s behind"),  # few results are late, so that the median does not show it
        (0.4, 4, (0, 0), 4.0, ""),  # a camera of 10 frames/s, whose frames the tracker defers
        (0.01, 1, (0, 0), 7800.0, "7.8 s behind"),
        (7.8, 2000, (900, 0), None, "7.8 s behind"),
        (0.01, 1, (12, 3), 4.0, "12 frames lost within 1 s"),
        (0.01, 1, (0, 3), 4.0, "3 messages lost within 1 s"),
    ],
)
def test_how_results_fall_behind_is_said(
    age: float, trailing: int, lost: tuple[int, int], median: float | None, said: str
) -> None:
    rule = KeepingUp(waiting=4)
    assert rule.said(0.0, 0.0, 0, (0, 0), None) == ""
    assert rule.said(0.5, age, trailing, lost, median) == said


def test_a_slow_engine_turns_the_page_amber(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    """A camera of 250 frames/s and an engine that takes 20 ms a frame: the page says that results fall behind or frames
    are lost, while the median latency of `latest` stays below 0.1 s.
    """
    found: list[Player] = []
    run, step = Player.run, StreamTracker.step
    monkeypatch.setattr(Player, "run", lambda one: (found.append(one), run(one))[1])
    monkeypatch.setattr(StreamTracker, "step", lambda tracker, frame: (time.sleep(0.02), step(tracker, frame))[1])
    said = set[str]()
    ends = time.monotonic() + 60

    def grab() -> Any:
        time.sleep(0.004)
        if found:
            said.add(found[0]._said_by_page()["behind"])
        return None if len(said) > 1 or time.monotonic() > ends else frame(contact_px=40)

    options: dict[str, Any] = {"policy": "latest", "page": "off", "threads": 1, "output": stream.folder / "results"}
    player.play(stream.bundle, lambda: grab, **options)
    (behind,) = said - {""}
    assert re.fullmatch(r"[\d.]+ s behind|\d+ frames? lost within 1 s", behind)
