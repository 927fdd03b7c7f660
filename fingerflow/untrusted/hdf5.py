"""HDF5 files, opened only when another process has gone through them and lived."""

from __future__ import annotations

import atexit
import json
import os
import subprocess
import sys
import threading
import warnings
from multiprocessing.spawn import get_executable
from pathlib import Path
from typing import Any

import h5py

from fingerflow.errors import FingerflowError
from fingerflow.untrusted import hdf5_walk
from fingerflow.untrusted.files import check_file, plausible_size, reading

KIND = "HDF5"
_MOST_SECONDS = 120.0  # on the wall, for disks that hang


def open_hdf5(path: Path, **options: Any) -> h5py.File:
    """`h5py.File(path, "r")` of a file that a process of its own could go through.

    The first file costs 0.2 s for that process, every other one a millisecond or two.

    Raises FingerflowError where it cannot be opened, or where going through it crashed the library, took more than 10 s
    of a processor or 1 GiB.
    """
    check_file(path)
    check_hdf5(path)
    with reading(path, KIND):
        return h5py.File(path, "r", **options)


def check_hdf5(path: Path) -> None:
    """Raises FingerflowError where going through the file ends, or would end, the process that does it."""
    wrong = _walker.ask(path)
    if wrong:
        raise FingerflowError(f"{path}: is damaged as {KIND}: {wrong}; copy it again, or export it anew")


def stored_whole(values: h5py.Dataset, path: Path) -> None:
    """Checks that what a data set claims to hold can be in the file, before memory is taken for it.

    Raises FingerflowError where its values were never written, end beyond the file, or lie in other files that are not
    there: HDF5 itself gives zeros for these without a word.
    """
    again = "copy the file again, or export it anew"
    with reading(path, KIND):
        claimed, stored, size = values.size * values.dtype.itemsize, values.id.get_storage_size(), path.stat().st_size
        if values.is_virtual:
            return _sources_there(values, path)
        if values.external:
            for name, offset, length in values.external:
                _external_there(path.parent / os.fsdecode(name), offset + length, values.name, path)
            return
        if claimed and not stored:
            raise FingerflowError(f"{path}: {values.name} {values.shape} was created but never written; {again}")
        offset = values.id.get_offset()
        ends_late = offset is not None and offset + stored > size
        fits = stored >= claimed if values.chunks is None else plausible_size(claimed, min(stored, size))
        if ends_late or stored > 2 * size or not fits:
            raise FingerflowError(
                f"{path}: {values.name} {values.shape} should have {claimed} bytes, and the file of {size} cannot hold "
                f"them; {again}"
            )


def _sources_there(values: h5py.Dataset, path: Path) -> None:
    for source in values.virtual_sources():
        name = source.file_name
        if name == ".":
            continue
        # HDF5 looks for the path as it is written, then beside the file; "%b" counts through several.
        pattern = name.replace("%b", "*")
        found = [place for place in (Path(pattern), path.parent / pattern, path.parent / Path(pattern).name)
                 if (place.exists() if "*" not in pattern else any(place.parent.glob(place.name)))]  # fmt: skip
        if not found:
            raise FingerflowError(
                f"{path}: the values of {values.name} lie in {name}, which is not there; copy it beside this file"
            )
        if "*" not in pattern and "%" not in source.dset_name:
            with open_hdf5(found[0]) as other:
                if source.dset_name not in other:
                    raise FingerflowError(
                        f"{path}: the values of {values.name} lie in {source.dset_name} of {found[0]}, which is not in "
                        "it; copy that file again"
                    )


def _external_there(file: Path, needed: int, name: str, path: Path) -> None:
    there = file.stat().st_size if file.is_file() else -1
    if there < needed:
        state = "is not there" if there < 0 else f"has {there} of {needed} bytes"
        raise FingerflowError(f"{path}: the values of {name} lie in {file}, which {state}; copy it beside this file")


class _Walker:
    """The process that goes through files, started when it is first needed and again after each file that ends it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._owner = 0
        self._cannot_start = False

    def ask(self, path: Path) -> str:
        """What is wrong with the file; "" for nothing."""
        with self._lock:
            process = self._running()
            if process is None:
                return ""
            answer = self._answer(process, json.dumps(str(path.resolve())))
            if answer is not None:
                return str(answer)
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
        command = [os.fsdecode(get_executable()), str(Path(hdf5_walk.__file__))]
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
            warnings.warn(f"HDF5 files are opened unchecked: {command[0]} does not start", RuntimeWarning, stacklevel=5)
            return None
        self._process, self._owner = process, os.getpid()
        return process

    def _answer(self, process: subprocess.Popen[str], line: str | None) -> Any:
        """One line of answer; None where the process ended instead."""
        assert process.stdin is not None
        assert process.stdout is not None
        limit = threading.Timer(_MOST_SECONDS, process.kill)
        limit.daemon = True
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
        return json.loads(answer) if answer.endswith("\n") else None

    def close(self) -> None:
        if self._process is not None and self._owner == os.getpid():
            self._process.communicate()  # its input ends, and so does it


def _end(status: int) -> str:
    import signal

    if status < 0 and -status in (getattr(signal, "SIGPROF", 0), getattr(signal, "SIGKILL", 0)):
        return f"did not come to an end within {hdf5_walk.CPU_SECONDS:g} s"
    return "crashed"


_walker = _Walker()
atexit.register(_walker.close)
