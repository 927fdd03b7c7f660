"""Read damaged files with every reader and count how this ends: `python -m tests.fuzz`.

Each input is made from a small real file by a seeded generator and read in a process with a limit of memory and of
processor time. The outcomes `read` and `own error`, which names the file, are right; every other outcome is printed
with the number that makes its input again: `python -m tests.fuzz --reader tiff --seed 16 --first 4711 --count 1`.
"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from fingerflow.recordings.guard.idle import IdleLimit
from tests.fuzz.samples import READERS

OUTCOMES = ("read", "own error", "unnamed", "traceback", "memory", "hang", "crash")
GOOD = ("read", "own error")
ROOT = Path(__file__).resolve().parents[2]
MOST_IDLE_SECONDS = 150.0  # s without work; longer than a reader waits for its own child process


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description="Reads damaged files by every reader.")
    parser.add_argument("--count", type=int, default=300, help="inputs, of all readers together (300)")
    parser.add_argument("--reader", choices=READERS, action="append", help="only this one; may be repeated")
    parser.add_argument("--seed", type=int, default=16)
    parser.add_argument("--first", type=int, default=0, help="number of the first input of each reader")
    asked = parser.parse_args(arguments)
    readers = asked.reader or list(READERS)
    shares = [asked.count // len(readers) + (n < asked.count % len(readers)) for n in range(len(readers))]
    print(f"seed {asked.seed}, {asked.count} inputs")
    print(f"{'reader':15}" + "".join(f"{outcome:>11}" for outcome in OUTCOMES))
    counts = {reader: Counter[str]() for reader in readers}
    shown: set[tuple[str, str, str]] = set()
    jobs = [(reader, asked.first, asked.first + share) for reader, share in zip(readers, shares, strict=True) if share]
    for reader, number, outcome, said in _run(asked.seed, jobs):
        counts[reader][outcome] += 1
        kind = (reader, outcome, said.partition(":")[0])
        if outcome not in GOOD and kind not in shown:  # print one of each kind
            shown.add(kind)
            print(f"  {reader} {number}: {outcome}: {said}", flush=True)
        if (reader, number + 1) in {(name, end) for name, _, end in jobs}:
            print(f"{reader:15}" + "".join(f"{counts[reader][outcome]:11}" for outcome in OUTCOMES), flush=True)
    totals = sum(counts.values(), Counter[str]())
    print(f"{'all':15}" + "".join(f"{totals[outcome]:11}" for outcome in OUTCOMES))
    return 0 if set(totals) <= set(GOOD) else 1


def _run(seed: int, jobs: list[tuple[str, int, int]]) -> Iterator[tuple[str, int, str, str]]:
    """Yield (reader, number, outcome, message) of each input, whatever happens to the process that reads."""
    while jobs:
        command = [sys.executable, "-m", "tests.fuzz.worker", str(seed), json.dumps(jobs)]
        with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as worker:
            begun = None
            assert worker.stdout is not None
            for line in _lines(worker, worker.stdout):
                facts = json.loads(line)
                begun = facts.get("begun")
                if begun is None:
                    yield facts["reader"], facts["number"], facts["outcome"], facts.get("said", "")
                    jobs = _rest(jobs, facts["reader"], facts["number"])
                else:
                    reader = facts["reader"]
            assert worker.stderr is not None
            complaint = worker.stderr.read().decode(errors="replace")
            status = worker.wait()
        if begun is not None:
            hung = status in (-signal.SIGPROF, -signal.SIGKILL)
            yield reader, begun, "hang" if hung else "crash", _name(status)
            jobs = _rest(jobs, reader, begun)
        elif status:
            raise SystemExit(f"the process that reads ended with {_name(status)} before any damaged input\n{complaint}")


def _rest(jobs: list[tuple[str, int, int]], reader: str, number: int) -> list[tuple[str, int, int]]:
    """Return the jobs that are left after an input; jobs are done in their order."""
    (name, _, end), *others = jobs
    assert name == reader
    return others if number + 1 == end else [(name, number + 1, end), *others]


def _lines(worker: subprocess.Popen[bytes], answers: IO[bytes]) -> Iterator[bytes]:
    """Yield the whole lines of the worker. The first arrives after samples are made and libraries loaded, which takes
    long on a busy machine.
    """
    with IdleLimit(worker.pid, MOST_IDLE_SECONDS):
        yield from (line for line in answers if line.endswith(b"\n"))


def _name(status: int) -> str:
    return signal.Signals(-status).name if status < 0 else f"status {status}"


if __name__ == "__main__":
    sys.exit(main())
