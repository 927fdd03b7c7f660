"""Tests of playing from Python: the function, the loop, and the benchmark."""

import threading
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from tiny_bundle import Stream, frame

from fingerflow import player
from fingerflow.player.benchmark import benchmark


@pytest.fixture
def source(stream: Stream) -> dict[str, Any]:
    """Return the arguments of `play` for nine frames of a file."""
    named = {"bundle": stream.bundle, "source": stream.recorded(9)[1], "output": stream.folder / "results"}
    return {**named, "page": "off", "threads": 1}


def test_a_function_is_called_with_each_frame(source: dict[str, Any]) -> None:
    found: list[tuple[int, float]] = []

    def take(stamp: player.FrameStamp, values: Mapping[str, float]) -> None:
        found.append((stamp.number, values["real_contact_area"]))

    summary = player.play(on_frame=take, **source)
    assert found == [(k, 2.5 * k) for k in range(9)]
    assert summary["outputs"][0]["sent"] == summary["processed"] == 9
    np.testing.assert_array_equal(player.read_results(source["output"]).records["frame"], np.arange(9))


def test_a_loop_gets_each_frame_and_ends_the_stream(source: dict[str, Any], stream: Stream) -> None:
    areas = [values["real_contact_area"] for _, values in player.live_frames(**source)]
    assert areas == [2.5 * k for k in range(9)]
    before = threading.active_count()
    cameras = player.live_frames(
        stream.bundle, lambda: lambda: frame(contact_px=40), output=stream.folder / "more", page="off", threads=1
    )
    for stamp, values in cameras:
        assert values["real_contact_area"] == 10
        assert stamp.record["position_px"].shape == (10, 2)
        break
    cameras.close()  # type: ignore[attr-defined]
    assert threading.active_count() <= before


@pytest.mark.long
def test_the_benchmark_says_a_rate_and_its_latency(stream: Stream, capsys: pytest.CaptureFixture[str]) -> None:
    said = benchmark(stream.bundle, {"engine": "native"}, 0.1, 0.1).splitlines()
    assert said[0].startswith("as fast as possible: ")
    assert ", computed by native; limit: " in said[0]
    assert said[1].split() == ["frames/s", "median", "ms", "p99", "ms", "overruns"]
    assert said[-1].startswith("This PC holds ")
    shares = [float(line.split()[0]) for line in said[2:-1]]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] == pytest.approx(0.9 * float(said[0].split()[4]), rel=0.02)
