"""The process that reads a file first, so that what a damaged one does to a library is done to it alone."""

from __future__ import annotations

import atexit
import base64
import io
import json
import os
import signal
import subprocess
import sys
import threading
import warnings
from multiprocessing.spawn import get_executable
from pathlib import Path
from typing import Any

import numpy as np

from fingerflow.errors import FingerflowError
from fingerflow.recordings.guard import walk
from fingerflow.recordings.guard.idle import IdleLimit

_MOST_IDLE_SECONDS = 120.0  # for disks that hang


def check_by_walking(path: Path, kind: str) -> None:
    """Lets another process go through a file of a kind of `walk.WALKS`, and returns if it lives.

    The first file costs 0.2 s for that process, an HDF5 file then 1 to 4 ms, the others as much as reading them.

    Raises FingerflowError where that crashed the library, took more than 10 s of a processor, or more memory than a
    file of its size can need.
    """
    _sound(path, kind, _walker.ask(path, kind))


def read_matlab_apart(path: Path) -> dict[str, Any]:
    """What is in a MATLAB file, read by that process: structs as mappings, arrays of numbers, texts, None for all else.

    Raises FingerflowError as :func:`check_by_walking`, and where it cannot be read.
    """
    found = _walker.ask(path, "MATLAB")
    _sound(path, "MATLAB", found)
    return dict(_from_json(found or walk.as_json(walk.read_matlab(str(path)))))


def _sound(path: Path, kind: str, answer: Any) -> None:
    if answer and isinstance(answer, str):
        raise FingerflowError(f"{path}: is damaged, or no {kind} file: {answer}; copy it again, or export it anew")


def _from_json(value: Any) -> Any:
    if isinstance(value, dict):
        if ".npy" in value:
            return np.load(io.BytesIO(base64.b64decode(value[".npy"])), allow_pickle=False)
        return {name: _from_json(one) for name, one in value.items()}
    return value


class _Walker:
    """The process that goes through files, started when it is first needed and again after each file that ends it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._owner = 0
        self._cannot_start = False

    def ask(self, path: Path, kind: str) -> Any:
        """What is wrong with the file, "" for nothing or where there is no such process; or what is in it."""
        with self._lock:
            process = self._running()
            if process is None:
                return ""
            try:
                answer = self._answer(process, json.dumps([str(path.resolve()), kind]))
            except BaseException:  # interrupted: its answer must not become that of the next file
                process.kill()
                self._process = None
                raise
            if answer is not None:
                return answer
            status = process.wait()
            self._process = None
        return f"the library {_end(status)} while its structure was gone through"

    def _running(self) -> subprocess.Popen[str] | None:
        # A forked process has the pipes of its parent, whose answers are not its own.
        if self._process is not None and self._owner == os.getpid() and self._process.poll() is None:
            return self._process
        if self._cannot_start:
            return None
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        command = [os.fsdecode(get_executable()), "-P", str(Path(walk.__file__))]
        try:
            process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
                env=environment,
            )  # fmt: skip
            ready = self._answer(process, None) == "ready"
        except OSError:
            ready = False
        if not ready:  # inside programs that have no Python to start
            self._cannot_start = True
            warnings.warn(
                f"damaged files are not kept apart: {command[0]} does not start", RuntimeWarning, stacklevel=5
            )
            return None
        self._process, self._owner = process, os.getpid()
        return process

    def _answer(self, process: subprocess.Popen[str], line: str | None) -> Any:
        """One line of answer; None where the process ended instead."""
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            with IdleLimit(process.pid, _MOST_IDLE_SECONDS):
                if line is not None:
                    process.stdin.write(line + "\n")
                    process.stdin.flush()
                answer = process.stdout.readline()
        except OSError:
            return None
        return json.loads(answer) if answer.endswith("\n") else None

    def close(self) -> None:
        if self._process is not None and self._owner == os.getpid():
            self._process.communicate()  # its input ends, and so does it


def _end(status: int) -> str:
    if status < 0 and -status in (getattr(signal, "SIGPROF", 0), getattr(signal, "SIGKILL", 0)):
        return f"did not come to an end within {walk.CPU_SECONDS:g} s"
    return "crashed"


_walker = _Walker()
atexit.register(_walker.close)
