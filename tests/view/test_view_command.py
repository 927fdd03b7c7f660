"""Tests of the command `fingerflow view` as a process of its own."""

import http.client
import signal
import subprocess
import sys
from pathlib import Path
from urllib.parse import urlparse

import pytest

ROOT = Path(__file__).resolve().parents[2]
SLOW = 300  # s, enough for a busy machine


@pytest.mark.skipif(sys.platform == "win32", reason="an interrupt cannot be sent to one process alone")
def test_the_view_serves_until_interrupted(processed: Path) -> None:
    command = [sys.executable, "-m", "fingerflow", "view", str(processed / "result.h5"), "--no-browser"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        address = urlparse(running.stdout.readline().strip())
        assert address.hostname == "127.0.0.1"
        connection = http.client.HTTPConnection("127.0.0.1", address.port, timeout=SLOW)
        connection.request("GET", f"{address.path}?{address.query}")
        assert connection.getresponse().status == 200
        connection.close()
        running.send_signal(signal.SIGINT)
        _, said = running.communicate(timeout=SLOW)
    assert running.returncode in (0, 130), said
    assert "Traceback" not in said


def test_what_is_not_installed_is_named() -> None:
    code = "import sys; sys.modules['tomlkit'] = None; sys.argv = ['fingerflow', 'view']; "
    code += "from fingerflow.cli import main; main()"
    ended = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert ended.returncode == 2
    assert "the page needs tomlkit, which is not installed: pip install starlette uvicorn tomlkit" in ended.stderr
    assert "Traceback" not in ended.stderr
