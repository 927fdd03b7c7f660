"""Read damaged files with every reader and count how this ends: `python -m tests.fuzz`.

Each input is made from a small real file by a seeded generator and read in a process with a limit of memory and of
processor time. The outcomes `read` and `own error`, which names the file, are right; every other outcome is printed
with the number that makes its input again: `python -m tests.fuzz --reader tiff --seed 16 --first 4711 --count 1`.
"""

import argparse
import io
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
from collections import Counter
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from fingerflow.errors import FingerflowError, PlayerError
from fingerflow.player import main as play_stream
from fingerflow.player.sources import open_source
from fingerflow.recordings import open_forces, open_recording
from fingerflow.results.stream_folder import write_table
from fingerflow.results.stream_result import open_stream
from tests.fuzz.damage import damage
from tests.fuzz.samples import HEIGHT, READERS, WIDTH, Sample, samples

OUTCOMES = ("read", "own error", "unnamed", "traceback", "memory", "hang", "crash")
GOOD = ("read", "own error")
CPU_SECONDS, MOST_SECONDS = 10, 150  # for each input; undamaged files take milliseconds
GROWTH = 2**30  # bytes of address space more than the libraries take, for files of a few kB
RESIDENT = 200 * 2**20  # bytes of memory that were touched
HANGS = (-signal.SIGXCPU, -signal.SIGALRM, -signal.SIGKILL)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description="Reads damaged files by every reader.")
    parser.add_argument("--count", type=int, default=300, help="inputs, of all readers together (300)")
    parser.add_argument("--reader", choices=READERS, action="append", help="only this one; may be repeated")
    parser.add_argument("--seed", type=int, default=16)
    parser.add_argument("--first", type=int, default=0, help="number of the first input of each reader")
    asked = parser.parse_args(arguments)
    readers = asked.reader or list(READERS)
    print(f"seed {asked.seed}, {asked.count} inputs")
    print(f"{'reader':15}" + "".join(f"{outcome:>11}" for outcome in OUTCOMES))
    totals = Counter[str]()
    for place, reader in enumerate(readers):
        counts, share = Counter[str](), asked.count // len(readers) + (place < asked.count % len(readers))
        with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
            folder = Path(name)
            (folder / "samples").mkdir()
            found = samples(reader, folder / "samples")
            for sample in found:  # undamaged, read first so that the libraries are loaded
                READ[reader](write(sample, folder / "whole", sample.files[sample.damaged]))
            for number in range(asked.first, asked.first + share):
                rng = random.Random(f"{asked.seed} {reader} {number}")
                sample, other = rng.choice(found), rng.choice(found)
                data = damage(sample.files[sample.damaged], other.files[other.damaged], rng)
                outcome, said = outcome_of(READ[reader], write(sample, folder / "damaged", data), folder / "damaged")
                counts[outcome] += 1
                if outcome not in GOOD:
                    print(f"  {reader} {number}: {outcome}: {said}", flush=True)
        print(f"{reader:15}" + "".join(f"{counts[outcome]:11}" for outcome in OUTCOMES), flush=True)
        totals += counts
    print(f"{'all':15}" + "".join(f"{totals[outcome]:11}" for outcome in OUTCOMES))
    return 0 if set(totals) <= set(GOOD) else 1


def write(sample: Sample, folder: Path, data: bytes) -> Path:
    """Write the files of a sample, the damaged one with the bytes `data`; return the path that the reader opens."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name, content in sample.files.items():
        (folder / name).write_bytes(data if name == sample.damaged else content)
    return folder / sample.opened


def outcome_of(read: Callable[[Path], object], path: Path, folder: Path) -> tuple[str, str]:
    """Read a file in a process of its own, under limits; return how this ends, and the message."""
    answer, answering = os.pipe()
    sys.stdout.flush()
    process = os.fork()
    if not process:
        _limit()
        os.write(answering, "\n".join(_read(read, path, folder))[:4000].encode(errors="replace"))
        os._exit(0)
    os.close(answering)
    with open(answer, encoding="utf-8", errors="replace") as said:
        outcome, _, message = said.read().partition("\n")
    status = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    if status:
        return "hang" if status in HANGS else "crash", f"status {status}"
    return outcome, message


def _limit() -> None:
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() + GROWTH
    for limit, most in ((resource.RLIMIT_AS, size), (resource.RLIMIT_CORE, 0)):
        resource.setrlimit(limit, (most, most))
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_SECONDS, CPU_SECONDS + 1))  # ends loops in C too
    signal.alarm(MOST_SECONDS)  # longer than a reader waits for its own child process
    for output in (1, 2):  # libraries write about damaged files
        os.dup2(os.open(os.devnull, os.O_WRONLY), output)


def _read(read: Callable[[Path], object], path: Path, folder: Path) -> tuple[str, str]:
    before, outcome, said = _most_resident(), "read", ""
    try:
        read(path)
    except BaseException as error:
        chain: list[BaseException] = [error]
        while (cause := chain[-1].__cause__ or chain[-1].__context__) is not None and cause not in chain:
            chain.append(cause)
        if any(isinstance(one, MemoryError) for one in chain):
            outcome, said = "memory", str(error)
        elif isinstance(error, FingerflowError):
            outcome, said = "own error" if str(folder) in str(error) else "unnamed", str(error)
        else:
            outcome, said = "traceback", traceback.format_exc()
    touched = _most_resident() - before
    return ("memory", f"{touched >> 20} MiB touched") if touched > RESIDENT else (outcome, said)


def _most_resident() -> int:
    """Return the peak of resident memory, bytes; getrusage would count that of the parent process."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmHWM")).split()[1]) * 1024


def _frames(path: Path) -> None:
    with open_recording(path) as recording:
        _ = recording.times, repr(recording), recording.warnings, recording.unreadable
        for index in sorted({0, len(recording) // 2, len(recording) - 1}):
            frame = recording[index]
            assert frame.shape == recording.frame_shape
            assert frame.dtype == recording.dtype


def _forces(path: Path) -> None:
    unstated = path.name in ("old.mat", "new.mat")  # formats without units
    found = open_forces(path, units={"normal": "N", "tangential": "N"} if unstated else None)
    found.resample(found.times[0] + [0.0, 1 / 300, 2 / 300])


def play(bundle: Path) -> Path:
    """Play the scene of a bundle as `fingerflow stream` does; return the folder of results.

    Raises PlayerError with the message of the player if it refuses.
    """
    logging.disable()  # log records would stay in memory
    results = bundle.parent / "results"
    shutil.rmtree(results, ignore_errors=True)
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()) as said:
        options = ["--output", str(results), "--page", "off", "--threads", "1"]
        options += ["--rate", "1e6"]  # a slow rate in the scene is not a hang
        if play_stream([str(bundle), *options]):
            raise PlayerError(said.getvalue())
    return results


def _streamed(path: Path) -> None:
    open_stream(path).load()
    write_table(path, path / "table.csv")


def _played(path: Path) -> None:
    source = open_source(path, (HEIGHT, WIDTH), "uint8")
    while source.read() is not None:
        pass
    source.close()


READ: dict[str, Callable[[Path], object]] = {
    **dict.fromkeys(("npy", "tiff", "hdf5", "cine", "mraw", "video", "images"), _frames),
    **dict.fromkeys(("forces_text", "forces_hdf5", "forces_matlab", "forces_tdms"), _forces),
    "calibration": lambda path: pkgutil.resolve_name("fingerflow.schema.calibration_file:read_calibration")(path),
    "scene": lambda path: pkgutil.resolve_name("fingerflow.schema.scene:load_scene")(path),
    "bundle": lambda path: pkgutil.resolve_name("fingerflow.engines.bundle:load_bundle")(path),
    "result": lambda path: pkgutil.resolve_name("fingerflow.results.result:load_result")(path),
    "stream": lambda path: _streamed(play(path)),
    "streamed": _streamed,
    "played": _played,
}


if __name__ == "__main__":
    sys.exit(main())
