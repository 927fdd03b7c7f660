"""Fixture of a stream of the tiny bundle, run by the compiled library as the command line runs it."""

import json
import logging
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import pytest
from tiny_bundle import frame, write_bundle, write_scene

from fingerflow import player
from fingerflow.kernels.library import is_present


class Ended(NamedTuple):
    """The end of a stream: exit code, summary (empty after an error), the text of stderr and of the log, and the
    results if there are any.
    """

    code: int
    summary: dict[str, Any]
    said: str
    results: player.StreamResults


class Stream:
    """Runs `player.main` in a folder of its own."""

    def __init__(
        self,
        folder: Path,
        capsys: pytest.CaptureFixture[str],
        caplog: pytest.LogCaptureFixture,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        self.folder = folder
        self.bundle = write_bundle(folder / "bundle")
        self.scene = write_scene(self.bundle / "scene.toml")
        self.play: Callable[[list[str]], int] = player.main
        self._capsys, self._caplog, self._monkeypatch = capsys, caplog, monkeypatch
        caplog.set_level(logging.INFO)

    def camera(self, make: Callable[[], Any]) -> tuple[str, str]:
        """Return the arguments of the command line that make a factory of the test the camera."""
        module = ModuleType("camera_of_the_test")
        module.make = make  # type: ignore[attr-defined]
        self._monkeypatch.setitem(sys.modules, module.__name__, module)
        return "--camera", f"{module.__name__}:make"

    def recorded(self, count: int) -> tuple[str, str]:
        """Return the arguments for a file of `count` frames, of which frame k has 10 k pixels in contact."""
        np.save(self.folder / "frames.npy", np.stack([frame(contact_px=10 * k) for k in range(count)]))
        return "--source", str(self.folder / "frames.npy")

    def frames(self, frames: Iterable[Any]) -> tuple[str, str]:
        """Return the arguments for a camera that gives these frames; an exception among them is raised."""
        left = iter(frames)

        def grab() -> Any:
            found = next(left, None)
            if isinstance(found, Exception):
                raise found
            return found

        return self.camera(lambda: grab)

    def run(self, *arguments: str) -> Ended:
        output = self.folder / "results"
        given = [str(self.bundle), "--output", str(output), "--threads", "1", *arguments]
        code = self.play(given if "--page" in arguments else [*given, "--page", "off"])
        said = self._capsys.readouterr()
        results = player.read_results(output) if output.exists() else None
        return Ended(code, json.loads(said.out) if said.out else {}, said.err + self._caplog.text, results)  # type: ignore[arg-type]

    def refused(self, *arguments: str) -> str:
        """Return the text of stderr and of the log of a stream that ends with an error of the user and leaves no
        results.
        """
        ended = self.run(*arguments)
        assert ended.code == 2
        assert ended.results is None
        return ended.said


@pytest.fixture
def stream(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> Stream:
    if not is_present():
        pytest.skip("the compiled library was not built or is turned off: graphs of the tiny bundle are none")
    return Stream(tmp_path, capsys, caplog, monkeypatch)
