"""Reads damaged files under limits, one after another; the process that watches it sees how each ended."""

from __future__ import annotations

import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.fuzz.damage import damage
from tests.fuzz.samples import HEIGHT, WIDTH, Sample, samples

CPU_SECONDS = 10.0  # an input; good ones take milliseconds
GROWTH = 512 * 2**20  # bytes of address space beyond those of the libraries, for files of a few kB
RESIDENT = 200 * 2**20  # bytes that were really touched


def serve(reader: str, seed: int, numbers: list[int]) -> None:
    """Writes a line before and after each input; ends without the second where the reader takes the process along."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what libraries write of damaged files
    os.dup2(1, 2)
    warnings.simplefilter("ignore")
    folder = Path(tempfile.mkdtemp(prefix=f"fuzz-{reader}-"))
    try:
        kept = folder / "samples"
        kept.mkdir()
        found = samples(reader, kept)
        read = _readers()[reader]
        for sample in found:
            _read_one(read, sample, folder / "whole", sample.files[sample.damaged])
        _limit_memory()
        for number in numbers:
            sample, data = damaged(found, reader, seed, number)
            print(json.dumps({"begun": number}), file=answers, flush=True)
            outcome = _outcome(read, sample, folder / "damaged", data)
            print(json.dumps({"number": number, **outcome}), file=answers, flush=True)
            if outcome["outcome"] == "memory":
                break  # its high-water mark stays: the next one needs a new process
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def damaged(found: list[Sample], reader: str, seed: int, number: int) -> tuple[Sample, bytes]:
    """The input of this number: which sample, and its bytes."""
    rng = random.Random(f"{seed} {reader} {number}")
    sample, other = rng.choice(found), rng.choice(found)
    return sample, damage(sample.files[sample.damaged], other.files[other.damaged], rng)


def write(sample: Sample, folder: Path, data: bytes) -> Path:
    """The files of a sample, one of them as `data`; returns what the reader is given."""
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


def _outcome(read: Callable[[Path], Any], sample: Sample, folder: Path, data: bytes) -> dict[str, str]:
    from fingerflow.errors import FingerflowError
    from fingerflow.player.errors import PlayerError

    before = _most_resident()
    # Of the processor's time, by a signal that ends the process: loops in C are seen too, and a busy machine is not.
    signal.setitimer(signal.ITIMER_PROF, CPU_SECONDS)
    try:
        _read_one(read, sample, folder, data)
        outcome = {"outcome": "read"}
    except (FingerflowError, PlayerError) as error:
        text = str(error)
        causes = _chain(error)
        if any(isinstance(cause, MemoryError) for cause in causes):
            outcome = {"outcome": "memory", "said": text}
        elif str(folder) not in text:
            outcome = {"outcome": "unnamed", "said": text}
        else:
            outcome = {"outcome": "own error", "said": text}
    except BaseException as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        own = [frame for frame in traceback.extract_tb(error.__traceback__) if "/fingerflow/" in frame.filename]
        place = f"{Path(own[-1].filename).name}:{own[-1].lineno}" if own else ""
        kind = "memory" if isinstance(error, MemoryError) else "traceback"
        said = f"{type(error).__name__} at {place} (in {Path(last.filename).name}:{last.lineno}): {error}"[:300]
        outcome = {"outcome": kind, "said": said}
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    if _most_resident() - before > RESIDENT:
        outcome = {"outcome": "memory", "said": f"{(_most_resident() - before) >> 20} MiB touched, then {outcome}"}
    return outcome


def _chain(error: BaseException | None) -> list[BaseException]:
    found = []
    while error is not None and error not in found:
        found.append(error)
        error = error.__cause__ or error.__context__
    return found


def _most_resident() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _read_one(read: Callable[[Path], Any], sample: Sample, folder: Path, data: bytes) -> None:
    read(write(sample, folder, data))


def _readers() -> dict[str, Callable[[Path], Any]]:
    from fingerflow.calibration import Calibration
    from fingerflow.player.bundle import load_bundle
    from fingerflow.player.results import write_table
    from fingerflow.player.sources import open_recording as play
    from fingerflow.recordings import open_forces, open_recording
    from fingerflow.result import load_result
    from fingerflow.scene import load_scene
    from fingerflow.stream_result import open_stream

    def frames(path: Path) -> None:
        with open_recording(path) as recording:
            _ = recording.times, repr(recording), recording.warnings
            for index in sorted({0, len(recording) // 2, len(recording) - 1}):
                if index not in getattr(recording, "unreadable", {}):
                    frame = recording[index]
                    assert frame.shape == recording.frame_shape
                    assert frame.dtype == recording.dtype

    def forces(path: Path) -> None:
        unstated = path.name in ("old.mat", "new.mat")  # whose formats have no place for units
        found = open_forces(path, units={"normal": "N", "tangential": "N"} if unstated else None)
        found.resample(found.times[0] + [0.0, 1 / 300, 2 / 300])

    def stream(path: Path) -> None:
        open_stream(path).load()
        write_table(path, path / "table.csv")

    def played(path: Path) -> None:
        source = play(path, (HEIGHT, WIDTH), "uint8")
        while source.read() is not None:
            pass
        source.close()

    by_frames = ("npy", "tiff", "hdf5", "cine", "mraw", "video", "images")
    by_forces = ("forces_text", "forces_hdf5", "forces_matlab", "forces_tdms")
    return {
        **dict.fromkeys(by_frames, frames),
        **dict.fromkeys(by_forces, forces),
        "calibration": Calibration.from_toml,
        "scene": load_scene,
        "bundle": load_bundle,
        "result": load_result,
        "stream": stream,
        "played": played,
    }


if __name__ == "__main__":
    serve(sys.argv[1], int(sys.argv[2]), list(range(int(sys.argv[3]), int(sys.argv[4]))))
