"""A fingerflow command that runs in a subprocess, with progress read from its output."""

import re
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import fingerflow

_COUNT = re.compile(r"(\w+):[^\r\n|]*\|[^\r\n|]*\|\s*(\d+)/(\d+)")
_KEPT = 4000  # number of last characters of the output that are kept
_READ = 256  # bytes read at a time


class Command:
    """A fingerflow command that runs in a subprocess; stopping it leaves no partly written file.

    Attributes:
        to: path of its output.
    """

    def __init__(self, arguments: Sequence[str | Path], to: Path) -> None:
        self.to = to
        self._said = ""
        self._process = subprocess.Popen(
            [sys.executable, "-m", "fingerflow", *map(str, arguments)],
            cwd=Path(fingerflow.__file__).resolve().parents[1],  # runs this package and no other installed one
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        self._listener = threading.Thread(target=self._listen, name="command", daemon=True)
        self._listener.start()

    def state(self) -> dict[str, Any]:
        """Return whether the command runs, failed or ended well, its progress and its last lines of output."""
        code = self._process.poll()
        if code is not None:
            self._listener.join(5)
        counts = _COUNT.findall(self._said)
        name, done, of = counts[-1] if counts else ("", "0", "0")
        lines = [line for line in re.split(r"[\r\n]+", self._said) if line.strip() and not _COUNT.search(line)]
        return {
            "running": code is None,
            "failed": code not in (None, 0),
            "ended_well": code == 0,
            "step": name,
            "done": int(done),
            "of": int(of),
            "said": lines[-12:],
            "to": str(self.to),
        }

    def end(self) -> None:
        """Terminate the subprocess if it is still running."""
        if self._process.poll() is None:
            self._process.terminate()
            self._process.wait(20)

    def _listen(self) -> None:
        assert self._process.stdout is not None
        while part := self._process.stdout.read1(_READ):  # type: ignore[attr-defined]  # of a buffered pipe
            self._said = (self._said + part.decode(errors="replace"))[-_KEPT:]
