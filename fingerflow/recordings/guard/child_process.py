"""Child process that reads each file first, so that a damaged file crashes the child and not the caller."""

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
from fingerflow.recordings.guard import child_reader

_MOST_SECONDS = 600.0  # s for one file, also where a disk does not respond; its CPU time has a lower limit


def check_in_child_process(path: Path, file_type: str) -> Any:
    """Check that a child process can read a file of a `file_type` (key of `child_reader.READERS`) without a crash;
    return the content of a MATLAB file, "" for any other.

    The first file costs 0.2 s to start that process; then an HDF5 file costs 1 to 4 ms, others as much as reading them.

    Raises FingerflowError where the traversal crashed the library, took more than 10 s of CPU time, or needed more
    memory than a file of its size can need.
    """
    answer = _child.ask(path, file_type)
    if answer and isinstance(answer, str):
        raise FingerflowError(f"{path}: is damaged, or no {file_type} file: {answer}; copy or export it again")
    return answer


def read_matlab_in_child_process(path: Path) -> dict[str, Any]:
    """Read a MATLAB file in a child process, so that a damaged file cannot crash this one, and return its variables by
    name.

    Structs are mappings; arrays of numbers and texts are kept, all else is None. Raises FingerflowError as
    :func:`check_in_child_process`, and where the file cannot be read.
    """
    answer = check_in_child_process(path, "MATLAB")
    return dict(answer or _decoded(json.dumps(child_reader.as_json(child_reader.read_matlab(str(path))))))


def _decoded(text: str) -> Any:
    """Decode a JSON text, and the NumPy arrays in it that `child_reader.as_json` has written as base64."""

    def array(entries: dict[str, Any]) -> Any:
        coded = entries.get(".npy")
        return entries if coded is None else np.load(io.BytesIO(base64.b64decode(coded)), allow_pickle=False)

    return json.loads(text, object_hook=array)


class _ChildProcess:
    """Child process that reads through files to find those that crash a library; it is started on first use and
    restarted after each crash.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._owner = 0
        self._cannot_start = False

    def ask(self, path: Path, file_type: str) -> Any:
        """Let the child process read a file of a given `file_type`; return "" for a sound file, else a text with the
        error.

        Of a sound MATLAB file the content is returned instead.
        """
        with self._lock:
            process = self._running()
            if process is None:
                return ""
            try:
                answer = self._answer(process, json.dumps([str(path.resolve()), file_type]))
            except BaseException:  # interrupted: otherwise the late answer would be taken for that of the next file
                process.kill()
                self._process = None
                raise
            if answer is not None:
                return answer
            timed_out = -process.wait() in (getattr(signal, "SIGPROF", 0), getattr(signal, "SIGKILL", 0))
            self._process = None
        end = f"did not come to an end within {child_reader.CPU_SECONDS:g} s" if timed_out else "crashed"
        return f"the library {end} while its structure was gone through"

    def _running(self) -> subprocess.Popen[str] | None:
        # A forked process shares the pipes of its parent, and must not read the parent's answers.
        if self._process is not None and self._owner == os.getpid() and self._process.poll() is None:
            return self._process
        if self._cannot_start:
            return None
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        command = [os.fsdecode(get_executable()), "-P", str(Path(child_reader.__file__))]
        try:
            process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
                env=environment,
            )  # fmt: skip
            ready = self._answer(process, None) == "ready"
        except OSError:
            ready = False
        if not ready:  # a program that embeds Python may have no interpreter to start
            self._cannot_start = True
            warnings.warn(
                f"damaged files are not kept apart: {command[0]} does not start", RuntimeWarning, stacklevel=5
            )
            return None
        self._process, self._owner = process, os.getpid()
        return process

    def _answer(self, process: subprocess.Popen[str], line: str | None) -> Any:
        """Send a line of text as request to the child process; return the answer, or None if the process has ended."""
        assert process.stdin is not None
        assert process.stdout is not None
        limit = threading.Timer(_MOST_SECONDS, process.kill)
        limit.start()
        try:
            if line is not None:
                process.stdin.write(line + "\n")
                process.stdin.flush()
            answer = process.stdout.readline()
        except OSError:
            return None
        finally:
            limit.cancel()
        return _decoded(answer) if answer.endswith("\n") else None

    def close(self) -> None:
        if self._process is not None and self._owner == os.getpid():
            self._process.communicate()  # closes the child's input, at which it ends


_child = _ChildProcess()
atexit.register(_child.close)
