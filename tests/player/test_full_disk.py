"""Tests of a stream whose disk is full, for a while or for good, while it writes its results."""

import errno
import os
from pathlib import Path

import numpy as np
import pytest
from tiny_bundle import Stream

from fingerflow.player import read_results
from fingerflow.results import patient_file
from fingerflow.results.patient_file import PatientFile
from fingerflow.results.stream_folder import Sink

DTYPE = np.dtype([("frame", "<i8"), ("time", "<f8"), ("value", "<f4", (1000,))])
FIELDS = [
    {"name": "frame", "dtype": "<i8", "shape": [], "dims": ["frame"], "unit": ""},
    {"name": "time", "dtype": "<f8", "shape": [], "dims": ["frame"], "unit": "s"},
    {"name": "value", "dtype": "<f4", "shape": [1000], "dims": ["frame", "point"], "unit": "mm"},
]


class Disk:
    """Replaces `os.write` by a disk with `left` free bytes, and the clock by that of the test."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.left, self.now, self.slept = 10**9, 1000.0, 0.0
        self._write = os.write
        patch.setattr(patient_file.os, "write", self._take)
        patch.setattr(patient_file.time, "monotonic", lambda: self.now)
        patch.setattr(patient_file.time, "sleep", self._sleep)

    def _take(self, file: int, data: bytes) -> int:
        if not self.left:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        count = self._write(file, bytes(data[: self.left]))
        self.left -= count
        return count

    def _sleep(self, seconds: float) -> None:
        self.now += seconds
        self.slept += seconds


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    return Disk(monkeypatch)


def test_results_go_on_where_there_is_room_again(tmp_path: Path, disk: Disk, monkeypatch: pytest.MonkeyPatch) -> None:
    """After a disk has been full for a while every record is in the results, and an event says for how long."""
    clock = [0.0]
    monkeypatch.setattr("fingerflow.results.stream_folder.time.perf_counter", lambda: clock[0])
    sink = Sink(tmp_path / "results", {"format": 2, "fields": FIELDS})
    sink.open()
    records = np.zeros(40, DTYPE)
    records["frame"] = np.arange(40)
    records["value"] = np.random.default_rng(0).normal(size=(40, 1000))
    as_bytes = records.view(np.uint8).reshape(40, -1)
    for number in range(40):
        if number == 10:
            disk.left = 5000  # bytes, 1.25 records
        if number == 30:
            disk.left = 10**9
        clock[0] += 0.25
        disk.now += 0.25
        sink.write(as_bytes[number], number)
    sink.close()
    found = read_results(tmp_path / "results")
    assert found.records.tobytes() == records.tobytes()
    (event,) = [one for one in found.events if one["event"] == "disk_full"]
    assert 4 <= event["seconds"] <= 6
    assert 30 <= event["frame"] <= 34
    assert event["kept_bytes"] > 15 * DTYPE.itemsize
    assert disk.slept == 0


def test_a_disk_that_stays_full_ends_the_stream(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stream whose records go to /dev/full, which takes no byte, ends with exit code 2 and a sentence."""
    if not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full here")
    opened = Sink.open

    def open_full(sink: Sink) -> None:
        opened(sink)
        assert sink._records is not None
        sink._records.close()
        sink._records = PatientFile(Path("/dev/full"))

    monkeypatch.setattr(patient_file, "_PATIENCE", 0.5)
    monkeypatch.setattr(Sink, "open", open_full)
    ended = stream.run(*stream.recorded(100))
    assert ended.code == 2
    assert "No space left on device" in ended.said
    assert "records are kept in memory" in ended.said
    assert len(ended.results.records) == 0
