"""Tests that an idle process is ended, and that a process that works, or whose child works, is not."""

import subprocess
import sys

import pytest

from fingerflow.recordings.guard import idle
from fingerflow.recordings.guard.idle import IdleLimit

pytestmark = pytest.mark.long

WORKS = "import time\nwhile time.process_time() < 1.5: pass"
PARENT = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {WORKS!r}])"


@pytest.mark.parametrize(
    ("program", "ended"), [("import time; time.sleep(600)", True), (WORKS, False), (PARENT, False)]
)
def test_only_what_stands_still_is_ended(program: str, ended: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the idle process is ended after ten checks: fewer than the other processes need for their work, and more
    than a slow disk delays their start.
    """
    monkeypatch.setattr(idle, "_LOOK_SECONDS", 0.1)
    with subprocess.Popen([sys.executable, "-c", program]) as process, IdleLimit(process.pid, 1.0) as limit:
        status = process.wait()
    assert limit.reached == ended
    assert (status != 0) == ended
