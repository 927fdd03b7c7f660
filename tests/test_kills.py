"""Tests of a short run of `python -m tests.kills`, with the same moments each time, and of its parts."""

import errno
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

from fingerflow.results.result import save_result
from tests import kills

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[1]


def test_nothing_is_lost_and_nothing_left_behind() -> None:
    """Each of seven endings leaves no fault with a command that replaces its output and with one that does not."""
    command = [sys.executable, "-m", "tests.kills", "--count", "14", "--command", "process", "--command", "simulate"]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.splitlines()[-1] == "14 runs, 0 faults"


@pytest.mark.parametrize("size", [0, 100, -1])
def test_half_a_result_is_seen(size: int, tmp_path: Path) -> None:
    command = kills.COMMANDS["process"]
    whole, half = tmp_path / "whole.h5", tmp_path / "result.h5"
    save_result(xr.Dataset({"area": ("frame", np.arange(999.0))}, attrs={"fingerflow_version": "0"}), whole)
    assert kills._state(command, half, whole) == "absent"
    half.write_bytes(whole.read_bytes()[:size])
    assert kills._state(command, half, whole).startswith("is there and ")
    half.write_bytes(whole.read_bytes())
    assert kills._state(command, half, whole) == "whole"


def test_a_disk_fills_up_while_others_write_to_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free, allocate = [300, 200], os.posix_fallocate

    def of_200(file: int, start: int, size: int) -> None:
        if start + size > 100:
            raise OSError(errno.ENOSPC, "another one was faster")
        allocate(file, start, size)

    monkeypatch.setattr(kills.shutil, "disk_usage", lambda _: SimpleNamespace(free=free.pop(0)))
    monkeypatch.setattr(os, "posix_fallocate", of_200)
    kills.leave_free(tmp_path / "ballast", 100)
    assert (tmp_path / "ballast").stat().st_size == 100


def test_temporary_files_of_a_killed_command_are_recognised(tmp_path: Path) -> None:
    (tmp_path / "press").mkdir()
    before = kills._names(tmp_path)
    (tmp_path / "result.h5").touch()
    assert kills._left_behind(tmp_path, before, kills.COMMANDS["process"]) == []
    (tmp_path / ".result-00000000-1-00000000.h5").touch()
    assert kills._left_behind(tmp_path, before, kills.COMMANDS["process"]) == [
        "left behind: .result-00000000-1-00000000.h5"
    ]
