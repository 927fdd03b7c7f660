"""Tests that no run of bad frames gives wrong results without a warning, and that no clean frame is excluded."""

from pathlib import Path

import pytest

from fingerflow.kernels.library import is_present
from tests.silent import frames

pytestmark = pytest.mark.long


def test_no_bad_frame_of_a_recording_is_wrong_in_silence(tmp_path: Path) -> None:
    assert [one for one in frames.recorded(tmp_path) if one.verdict not in ("told", "within deviations")] == []


@pytest.mark.skipif(not is_present(), reason="the compiled library was not built or is turned off")
def test_no_bad_frame_of_a_stream_is_wrong_in_silence(tmp_path: Path) -> None:
    assert [one for one in frames.live(tmp_path) if one.verdict not in ("told", "within deviations")] == []


def test_nothing_is_excluded_without_a_fault(tmp_path: Path) -> None:
    assert [one for one in frames.without_fault(tmp_path) if one.verdict != "right"] == []
