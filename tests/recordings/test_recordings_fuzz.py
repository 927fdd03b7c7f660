"""Tests by a short run of `python -m tests.fuzz`: every reader, with the same inputs in each run."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[2]


def fuzz(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "tests.fuzz", *arguments], cwd=ROOT, capture_output=True, text=True)


def test_damaged_files_are_read_or_refused_in_a_sentence():
    run = fuzz("--count", "306", "--seed", "16", "--first", "0")
    assert run.returncode == 0, run.stdout + run.stderr
    total = run.stdout.splitlines()[-1].split()
    assert total[0] == "all"
    read, refused, *wrong = map(int, total[1:])
    assert (read + refused, sum(wrong)) == (306, 0)
    assert min(read, refused) > 60  # some damaged files are readable and some are not


def test_what_goes_wrong_is_seen(tmp_path):
    """The fuzz command counts a reader that hangs, crashes, exhausts memory or raises another exception as such."""
    broken = """
import os, sys, numpy as np
from pathlib import Path
import tests.fuzz.worker as worker
worker.CPU_SECONDS = 3  # a page that is touched first can take microseconds
def read(path):
    data = path.read_bytes()
    if data == whole: return
    kind = calls.pop(0)
    if kind == "hang":
        while True: pass
    if kind == "crash": os.abort()
    if kind == "memory": np.ones(1 << 30)
    if kind == "touched": np.ones(40 << 20)
    if kind == "traceback": raise KeyError("x")
    if kind == "unnamed": raise FingerflowError("something")
from fingerflow.errors import FingerflowError
from tests.fuzz.samples import samples
import tempfile
whole = None
kind = sys.argv[1]
calls = [kind] * 9
with tempfile.TemporaryDirectory() as made:
    wholes = [one.files[one.damaged] for one in samples("npy", Path(made))]
worker._READERS["npy"] = lambda path: None if path.read_bytes() in wholes else read(path)
worker.serve(3, [("npy", 0, 1)])
"""
    (tmp_path / "broken.py").write_text(broken)
    ends = {}
    for kind in ("hang", "crash", "memory", "touched", "traceback", "unnamed"):
        run = subprocess.run(
            [sys.executable, str(tmp_path / "broken.py"), kind], cwd=ROOT, capture_output=True, text=True,
            env={"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        )  # fmt: skip
        last = run.stdout.splitlines()[-1]
        ends[kind] = last.split('"outcome": "')[1].split('"')[0] if "outcome" in last else run.returncode
    assert ends == {
        "hang": -27, "crash": -6, "memory": "memory", "touched": "memory", "traceback": "traceback",
        "unnamed": "unnamed",
    }  # fmt: skip
