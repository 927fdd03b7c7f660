"""Tests of a stream by ONNX Runtime: it has the same numbers at any pace, and with frames computed side by side."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from fingerflow import player
from tests.small_trials import write_trial


class Runtime(NamedTuple):
    """A bundle and the scene of a slide whose threshold is measured; its points are lost and seeded again, and its key
    frame is replaced.
    """

    bundle: Path
    scene: Path

    def play(self, name: str, *arguments: str) -> player.StreamResults:
        output = self.scene.parent / name
        options = ["--scene", str(self.scene), "--output", str(output), "--page", "off", "--engine", "onnx"]
        given = [str(self.bundle), *options, "--threads", "1", *arguments]
        assert player.main(given if "--provider" in arguments else [*given, "--provider", "cpu"]) == 0
        return player.read_results(output)


@pytest.fixture(scope="module")
def runtime(bundle_of_trials: Path, tmp_path_factory: pytest.TempPathFactory) -> Runtime:
    scene = write_trial(tmp_path_factory.mktemp("runtime") / "slide", "slide")
    text = scene.read_text(encoding="utf-8")
    scene.write_text(text.replace("threshold = 0.27\n", ""), encoding="utf-8")
    return Runtime(bundle_of_trials, scene)


@pytest.fixture(scope="module")
def alone(runtime: Runtime) -> player.StreamResults:
    return runtime.play("alone")


def test_a_slower_pace_gives_the_same(runtime: Runtime, alone: player.StreamResults) -> None:
    other = runtime.play("paced", "--rate", "60")
    assert {event["event"] for event in alone.events} == {"restart", "key_frame", "threshold"}
    for name in set(alone.records.dtype.names or ()) - {"time", "latency"}:
        assert other.records[name].tobytes() == alone.records[name].tobytes(), name
    said = [[(one["event"], one["frame"]) for one in each.events] for each in (alone, other)]
    assert said[0] == said[1]
    assert other.header["engine"] == "onnx (CPUExecutionProvider)"


def test_openvino_gives_the_same(runtime: Runtime, alone: player.StreamResults) -> None:
    """OpenVINO, which copies bound arrays into its own memory, gives the numbers of the CPU provider: its copies of the
    templates are not out of date.
    """
    pytest.importorskip("onnxruntime_ep_openvino", reason="the package onnxruntime-ep-openvino is not installed")
    other = runtime.play("openvino", "--provider", "openvino")
    assert other.header["engine"] == "onnx (OpenVINOExecutionProvider)"
    first = slice(0, 24)  # frames in which hardly a point is lost
    for name in ("position_px", "real_contact_area", "gross_contact_area", "median_divergence"):
        np.testing.assert_allclose(other.records[name][first], alone.records[name][first], rtol=2e-3, atol=0.01)
