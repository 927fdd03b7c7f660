"""Tests by a short run of `python -m tests.fuzz`: every reader, with the same inputs in each run."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.long
def test_damaged_files_are_read_or_refused_in_a_sentence() -> None:
    command = [sys.executable, "-m", "tests.fuzz", "--count", "180", "--seed", "16"]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    total = run.stdout.splitlines()[-1].split()
    assert total[0] == "all"
    read, refused, *wrong = map(int, total[1:])
    assert (read + refused, sum(wrong)) == (180, 0)
    assert min(read, refused) > 36  # some damaged files are readable and some are not
