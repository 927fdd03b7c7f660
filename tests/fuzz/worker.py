"""Read damaged files under limits, one after another; the process that started this one sees how each ended."""

from __future__ import annotations

import io
import json
import logging
import os
import pkgutil
import random
import resource
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from tests.fuzz.damage import damage
from tests.fuzz.samples import HEIGHT, WIDTH, Sample, samples

CPU_SECONDS = 10.0  # for each input; undamaged files take milliseconds
GROWTH = 2**30  # bytes of address space more than the libraries take, for files of a few kB
RESIDENT = 200 * 2**20  # bytes of memory that were touched


def serve(seed: int, jobs: list[tuple[str, int, int]]) -> None:
    """Read the inputs from `first` to before `end` of each (reader, first, end); write a line before and after each
    input. The second line is missing if the reader ends the process.
    """
    answers = os.fdopen(os.dup(1), "w")
    warnings.simplefilter("ignore")
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    try:
        found = {}
        for reader, _, _ in jobs:
            kept = folder / reader
            kept.mkdir()
            found[reader] = samples(reader, kept)
            for sample in found[reader]:  # undamaged, read first so that the libraries are loaded
                _READERS[reader](write(sample, folder / "whole", sample.files[sample.damaged]))
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # libraries write about damaged files
        os.dup2(1, 2)
        _limit_memory()
        for reader, first, end in jobs:
            for number in range(first, end):
                sample, data = damaged(found[reader], reader, seed, number)
                print(json.dumps({"reader": reader, "begun": number}), file=answers, flush=True)
                outcome = outcome_of(_READERS[reader], sample, folder / "damaged", data)
                print(json.dumps({"reader": reader, "number": number, **outcome}), file=answers, flush=True)
                if outcome["outcome"] == "memory":
                    return  # the peak stays high: the next input needs a new process
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def damaged(found: list[Sample], reader: str, seed: int, number: int) -> tuple[Sample, bytes]:
    """Return the input of this number: its sample, and its bytes."""
    rng = random.Random(f"{seed} {reader} {number}")
    sample, other = rng.choice(found), rng.choice(found)
    return sample, damage(sample.files[sample.damaged], other.files[other.damaged], rng)


def write(sample: Sample, folder: Path, data: bytes) -> Path:
    """Write the files of a sample, the damaged one with the bytes `data`; return the path that the reader opens."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name, content in sample.files.items():
        (folder / name).write_bytes(data if name == sample.damaged else content)
    return folder / sample.opened


def _limit_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    size = pages * resource.getpagesize() + GROWTH
    resource.setrlimit(resource.RLIMIT_AS, (size, size))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def outcome_of(read: Callable[[Path], object], sample: Sample, folder: Path, data: bytes) -> dict[str, str]:
    from fingerflow.errors import FingerflowError

    before = _most_resident()
    # A limit of processor time, by a signal that ends the process: it ends loops in C too, whatever else runs.
    signal.setitimer(signal.ITIMER_PROF, CPU_SECONDS)
    outcome, said = "read", ""
    try:
        read(write(sample, folder, data))
    except BaseException as error:
        if any(isinstance(cause, MemoryError) for cause in _chain(error)):
            outcome, said = "memory", str(error)
        elif isinstance(error, FingerflowError):
            outcome, said = "own error" if str(folder) in str(error) else "unnamed", str(error)
        else:
            outcome, said = "traceback", f"{type(error).__name__} at {_place(error)}: {error}"[:300]
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    if _most_resident() - before > RESIDENT:
        outcome, said = "memory", f"{(_most_resident() - before) >> 20} MiB touched, then {outcome}"
    return {"outcome": outcome, "said": said}


def _place(error: BaseException) -> str:
    """Return the last line of the package that an error came through, and the last line of all."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "/fingerflow/" in frame.filename]
    return ", ".join(f"{Path(frame.filename).name}:{frame.lineno}" for frame in (*own[-1:], frames[-1]))


def _chain(error: BaseException | None) -> list[BaseException]:
    found: list[BaseException] = []
    while error is not None and error not in found:
        found.append(error)
        error = error.__cause__ or error.__context__
    return found


def _most_resident() -> int:
    """Return the peak of resident memory, bytes; getrusage would count that of the parent process."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmHWM")).split()[1]) * 1024


def _frames(path: Path) -> None:
    from fingerflow.recordings import open_recording

    with open_recording(path) as recording:
        _ = recording.times, repr(recording), recording.warnings, recording.unreadable
        for index in sorted({0, len(recording) // 2, len(recording) - 1}):
            frame = recording[index]
            assert frame.shape == recording.frame_shape
            assert frame.dtype == recording.dtype


def _forces(path: Path) -> None:
    from fingerflow.recordings import open_forces

    unstated = path.name in ("old.mat", "new.mat")  # formats without units
    found = open_forces(path, units={"normal": "N", "tangential": "N"} if unstated else None)
    found.resample(found.times[0] + [0.0, 1 / 300, 2 / 300])


def play(bundle: Path) -> Path:
    """Play the scene of a bundle as `fingerflow stream` does; return the folder of results.

    Raises PlayerError with the message of the player if it refuses.
    """
    from fingerflow.errors import PlayerError
    from fingerflow.player import main

    logging.disable()  # log records would stay in memory
    results = bundle.parent / "results"
    shutil.rmtree(results, ignore_errors=True)
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()) as said:
        options = ["--output", str(results), "--page", "off", "--threads", "1"]
        options += ["--rate", "1e6"]  # a slow rate in the scene is not a hang
        if main([str(bundle), *options]):
            raise PlayerError(said.getvalue())
    return results


def _streamed(path: Path) -> None:
    from fingerflow.results.stream_folder import write_table
    from fingerflow.results.stream_result import open_stream

    open_stream(path).load()
    write_table(path, path / "table.csv")


def _played(path: Path) -> None:
    from fingerflow.player.sources import open_source

    source = open_source(path, (HEIGHT, WIDTH), "uint8")
    while source.read() is not None:
        pass
    source.close()


def _called(name: str) -> Callable[[Path], object]:
    """Return a function that imports `name`, given as module:function, and calls it, so that a process imports only the
    modules of its readers.
    """
    return lambda path: pkgutil.resolve_name(name)(path)


_READERS: dict[str, Callable[[Path], object]] = {
    **dict.fromkeys(("npy", "tiff", "hdf5", "cine", "mraw", "video", "images"), _frames),
    **dict.fromkeys(("forces_text", "forces_hdf5", "forces_matlab", "forces_tdms"), _forces),
    "calibration": _called("fingerflow.schema.calibration_file:read_calibration"),
    "scene": _called("fingerflow.schema.scene:load_scene"),
    "bundle": _called("fingerflow.engines.bundle:load_bundle"),
    "result": _called("fingerflow.results.result:load_result"),
    "stream": lambda path: _streamed(play(path)),
    "streamed": _streamed,
    "played": _played,
}


if __name__ == "__main__":
    serve(int(sys.argv[1]), json.loads(sys.argv[2]))
