"""Tests of the command of the bench, its tables and its record, with suites that a user could add."""

import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest
import torch

from bench import __main__ as command
from bench import suites, timing
from bench.rows import Row, as_table
from fingerflow.kernels import tensors as kernels

SUITE = '''"""Counts to two."""

from bench.rows import Skipped


def run(quick):
    return [{"name": "one", "value": 1.0}, {"name": "quick" if quick else "full", "value": None, "more": True}]


def draw(rows, path):
    path.write_text(str(len(rows)))
'''
ABSENT = '''"""Needs what is not there."""

from bench.rows import Skipped


def run(quick):
    raise Skipped("there is no moon")
'''


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield a folder with two suites beside the real ones; figures go there too."""
    (tmp_path / "counting.py").write_text(SUITE)
    (tmp_path / "moon.py").write_text(ABSENT)
    monkeypatch.setattr(suites, "__path__", [*suites.__path__, str(tmp_path)])
    monkeypatch.setattr(command, "FIGURES", tmp_path / "figures")
    threads = cv2.getNumThreads()
    yield tmp_path
    cv2.setNumThreads(threads)


def test_one_file_is_a_suite(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command.main(["counting", "moon", "--json", str(folder / "new" / "run.json"), "--remark", "nothing else ran"])
    printed = capsys.readouterr().out
    assert "## counting\nCounts to two." in printed
    assert "skipped: there is no moon" in printed
    record = json.loads((folder / "new" / "run.json").read_text())
    assert record["suites"]["counting"]["rows"] == [
        {"name": "one", "value": 1.0},
        {"name": "full", "value": None, "more": True},
    ]
    assert record["suites"]["moon"] == {"skipped": "there is no moon"}
    assert record["remark"] == "nothing else ran"
    assert record["quick"] is False
    assert record["threads"]["torch"] == torch.get_num_threads()
    assert torch.__version__.split("+")[0] == record["versions"]["torch"].split("+")[0]
    assert record["machine"]["cores"] > 0
    assert record["kernels"]["compiled"] is kernels.serve()
    assert (folder / "figures" / "counting.png").read_text() == "2"


def test_quick_draws_no_figure(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command.main(["counting", "--quick"])
    assert "quick" in capsys.readouterr().out
    assert not (folder / "figures").exists()


def test_unknown_suite_is_refused_with_the_known_ones(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        command.main(["trackin"])
    message = capsys.readouterr().err
    assert "no suite trackin" in message
    assert "flow, flow_outliers, friction_loop" in message


def test_table_aligns_words_left_and_numbers_right() -> None:
    rows: list[Row] = [{"name": "a", "ms": 1.23456}, {"name": "long", "ms": 12345.6, "same": True}]
    assert as_table(rows).splitlines() == [
        "name         ms  same",
        "a         1.235",
        "long  1.235e+04   yes",
    ]


def test_candidates_take_turns_and_meet_the_peer_of_their_round(monkeypatch: pytest.MonkeyPatch) -> None:
    """Candidates take turns, and each is compared with the peer of the same round; a clock that the candidates move
    themselves makes every number known.
    """
    now = [0.0]
    monkeypatch.setattr(timing.time, "perf_counter", lambda: now[0])
    order: list[str] = []

    def candidate(name: str, seconds: float) -> None:
        order.append(name)
        now[0] += seconds * (1 + len(order) // 2 % 3)  # in some rounds the machine is slow

    times = timing.time_in_turns({"a": lambda: candidate("a", 1.0), "b": lambda: candidate("b", 1.0)}, "a", rounds=9)
    assert order == ["a", "b"] * 11
    assert times["a"].to_peer == 1
    assert times["a"].low_ms < times["a"].median_ms < times["a"].high_ms
    assert times["a"].median_ms == pytest.approx(2000)
    assert set(times["b"].cells()) == {"ms", "ms_p10", "ms_p90", "time_to_peer"}
