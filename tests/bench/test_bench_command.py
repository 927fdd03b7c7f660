"""Tests of the command of the bench, and its record, with suites that a user could add."""

import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest
import torch

from bench import __main__ as command
from bench import suites
from fingerflow.kernels import tensors as kernels

SUITE = '''"""Counts to two."""

def run(quick):
    return [{"name": "one", "value": 1.0}, {"name": "quick" if quick else "full", "value": None, "more": True}]


def draw(rows, path):
    path.write_text(str(len(rows)))
'''


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield a folder with a suite beside the real ones; figures go there too."""
    (tmp_path / "counting.py").write_text(SUITE)
    monkeypatch.setattr(suites, "__path__", [*suites.__path__, str(tmp_path)])
    monkeypatch.setattr(command, "FIGURES", tmp_path / "figures")
    threads = cv2.getNumThreads()
    yield tmp_path
    cv2.setNumThreads(threads)


def test_one_file_is_a_suite(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command.main(["counting", "--json", str(folder / "new" / "run.json"), "--remark", "nothing else ran"])
    assert "## counting\nCounts to two." in capsys.readouterr().out
    record = json.loads((folder / "new" / "run.json").read_text())
    assert record["suites"]["counting"]["rows"] == [
        {"name": "one", "value": 1.0},
        {"name": "full", "value": None, "more": True},
    ]
    assert record["remark"] == "nothing else ran"
    assert record["quick"] is False
    assert record["threads"]["torch"] == torch.get_num_threads()
    assert torch.__version__.split("+")[0] == record["versions"]["torch"].split("+")[0]
    assert record["machine"]["cores"] > 0
    assert record["kernels"]["compiled"] is kernels.serve()
    assert (folder / "figures" / "counting.png").read_text() == "2"
