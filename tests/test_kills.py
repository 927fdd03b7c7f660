"""Test of a short run of `python -m tests.kills`, with the same moments each time."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.long
def test_nothing_is_lost_and_nothing_left_behind() -> None:
    """Each of three endings leaves no fault with a command that replaces its output and with one that does not."""
    command = [sys.executable, "-m", "tests.kills", "--count", "6", "--command", "process", "--command", "simulate"]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.splitlines()[-1].startswith("6 runs, 0 faults")
