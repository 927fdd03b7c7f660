"""Fixture of a stream of the tiny bundle, run by the compiled library as the command line runs it."""

from pathlib import Path

import pytest
from tiny_bundle import Stream

from fingerflow.kernels.library import is_present


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
