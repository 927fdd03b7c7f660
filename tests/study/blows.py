"""`python -m tests.study.blows`: interrupt a study at random moments, and check that a rerun completes it.

A small study of eight trials runs by its command, in processes of its own. A seeded generator draws the faults: the
client with its workers, a worker or the scheduler is killed, Ctrl-C is sent, the disk of the results becomes full, a
tenth of the files of recordings is damaged before a run and restored afterwards, or a tenth of the files of results is
damaged. The number of finished rows at which each fault occurs is drawn as well. After three faults the study is run
again. Its table must equal that of an undisturbed run exactly, and no temporary file may remain. Half of the trials are
removed before each fault, so that there is work to interrupt. The disk is a file system in memory, which needs the
right to mount.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import psutil

from fingerflow.study.manifest import Manifest, load_manifest
from fingerflow.study.run_study import run_study
from fingerflow.study.table import write_tables
from fingerflow.study.trial_files import FAILED
from tests.kills import KEPT_FREE, disk_in_memory, leave_free
from tests.study.lab import write_lab, write_one_press

__all__ = ["BLOWS", "main"]
ROOT = Path(__file__).resolve().parents[2]
_IN_A_ROUND = 3
_PATIENCE = 300.0  # s, timeout for the end of a process
SCHEDULER = """
import sys
from distributed import LocalCluster
with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None, protocol="tcp://") as one:
    print(one.scheduler_address, flush=True)
    sys.stdin.read()
"""


def table_of(study: Manifest) -> pd.DataFrame:
    """Write the tables of a study and return the trials, without the names of the files of results."""
    return pd.read_parquet(write_tables(study).trials).drop(columns="result")


def start(lab: Path, *options: str) -> subprocess.Popen[bytes]:
    """Start `fingerflow study run` in its own group of processes."""
    command = [sys.executable, "-m", "fingerflow", "study", "run", str(lab), *(options or ("--workers", "2"))]
    return subprocess.Popen(
        command, env=_environment(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )


def start_scheduler() -> tuple[subprocess.Popen[str], str]:
    """Start a scheduler with its worker in one process; return the process and the address."""
    command, pipe = [sys.executable, "-c", SCHEDULER], subprocess.PIPE
    process = subprocess.Popen(command, stdin=pipe, stdout=pipe, env=_environment(), text=True)
    assert process.stdout is not None
    return process, process.stdout.readline().strip()


def workers_of(client: subprocess.Popen[bytes]) -> list[psutil.Process]:
    """Return the worker processes of a client with its own cluster."""
    found = psutil.Process(client.pid).children(recursive=True)
    servers = {one.pid for one in found if "forkserver" in " ".join(one.cmdline()) and one.ppid() == client.pid}
    return [one for one in found if one.ppid() in servers or "spawn_main" in " ".join(one.cmdline())]


def until(done: Callable[[], bool], process: subprocess.Popen[Any]) -> None:
    """Wait until `done()` is true or a process ends; raise AssertionError after 300 s."""
    for _ in range(3000):
        if done() or process.poll() is not None:
            return
        time.sleep(0.1)
    raise AssertionError("nothing came")


def end(process: subprocess.Popen[bytes], number: int = signal.SIGKILL) -> None:
    """Kill a process with its group if the process still runs."""
    if process.poll() is None:
        os.killpg(process.pid, number)
    process.wait(_PATIENCE)


def rows_of(study: Manifest) -> int:
    """Return the number of trials that have a row."""
    return len(list(study.results.glob("*/row.json")))


def damage(files: Sequence[Path], rng: random.Random) -> dict[Path, bytes]:
    """Damage a tenth of these files, at least one: truncated, emptied, or with other bytes in the middle. Return the
    original contents by file.
    """
    before = {}
    for file in rng.sample(list(files), max(1, len(files) // 10)):
        content = before[file] = file.read_bytes()
        place = rng.randrange(max(1, len(content)))
        other = rng.choice((content[:place], b"", content[:place] + rng.randbytes(16) + content[place + 16 :]))
        file.write_bytes(other)
    return before


def mend(before: Mapping[Path, bytes]) -> None:
    """Restore the files that `damage` changed."""
    for file, content in before.items():
        file.write_bytes(content)


def recorded(lab: Path) -> list[Path]:
    """Return the files of the recordings of a study."""
    return sorted(one for kind in ("npy", "csv") for one in lab.glob(f"p*/*/*/*.{kind}"))


def written(study: Manifest) -> list[Path]:
    """Return the files of the results of a study, one folder per trial."""
    return sorted(one for one in study.results.glob("*/*") if one.is_file())


class Struck:
    """A study and the faults that can interrupt its runs, each by its name."""

    def __init__(self, lab: Path, study: Manifest, ballast: Path | None, rng: random.Random) -> None:
        self._lab, self._study, self._ballast, self._rng = lab, study, ballast, rng
        self._moment = 0

    def deal(self, blow: str) -> None:
        """Remove the results of half of the trials, and start a run in which this fault occurs after some more rows."""
        for entry in self._rng.sample(self._study.trials, len(self._study.trials) // 2):
            shutil.rmtree(self._study.results / entry.name, ignore_errors=True)
        self._moment = rows_of(self._study) + self._rng.randrange(3)
        getattr(self, f"_{blow.replace(' ', '_')}")()

    def _run_until_moment(self, *options: str) -> subprocess.Popen[bytes]:
        client = start(self._lab, *options)
        until(lambda: rows_of(self._study) > self._moment, client)
        time.sleep(self._rng.random())
        return client

    def _client(self) -> None:
        end(self._run_until_moment())

    def _interrupt(self) -> None:
        client = self._run_until_moment()
        if client.poll() is None:
            client.send_signal(signal.SIGINT)
        client.wait(_PATIENCE)

    def _worker(self) -> None:
        client = self._run_until_moment()
        if client.poll() is None:
            for worker in workers_of(client)[:1]:
                worker.kill()
        client.wait(_PATIENCE)

    def _scheduler(self) -> None:
        other, address = start_scheduler()
        with other:
            client = self._run_until_moment("--scheduler", address)
            other.kill()
            client.wait(_PATIENCE)

    def _full_disk(self) -> None:
        assert self._ballast is not None
        client = self._run_until_moment()
        leave_free(self._ballast, self._rng.choice((0, KEPT_FREE, KEPT_FREE + (1 << 20))))
        client.wait(_PATIENCE)
        self._ballast.unlink()

    def _damaged_recordings(self) -> None:
        before = damage(recorded(self._lab), self._rng)
        start(self._lab).wait(_PATIENCE)
        mend(before)

    def _damaged_results(self) -> None:
        if files := written(self._study):
            damage(files, self._rng)


BLOWS = ("client", "worker", "scheduler", "interrupt", "full disk", "damaged recordings", "damaged results")


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.study.blows", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7, help=f"of {_IN_A_ROUND} blows and a rerun (7)")
    parser.add_argument("--seed", type=int, default=18)
    asked = parser.parse_args(arguments)
    rng, counts, faults = random.Random(asked.seed), Counter[str](), 0
    with tempfile.TemporaryDirectory() as name, disk_in_memory() as (disk, mounted):
        lab = Path(name) / "lab"
        write_lab(lab, write_one_press(Path(name) / "press"))
        manifest, results = lab / "study.toml", disk / "results"
        text = manifest.read_text(encoding="utf-8")
        manifest.write_text(text.replace('results = "results"', f'results = "{results}"'), encoding="utf-8")
        study = load_manifest(lab)
        undisturbed = replace(study, results=Path(name) / "undisturbed")
        run_study(undisturbed, workers=1, progress=False)
        expected = table_of(undisturbed)
        struck = Struck(lab, study, disk / "ballast" if mounted else None, rng)
        left = [one for one in BLOWS if mounted or one != "full disk"]
        deck: list[str] = []
        for number in range(asked.rounds):
            while len(deck) < _IN_A_ROUND:  # each kind occurs equally often
                deck += rng.sample(left, len(left))
            dealt, deck = deck[:_IN_A_ROUND], deck[_IN_A_ROUND:]
            for blow in dealt:
                struck.deal(blow)
                counts[blow] += 1
            summary = run_study(study, workers=1, progress=False)
            said = _differences(table_of(study), expected)
            said += [f"{one.name}: {one.reason}" for one in summary.outcomes if one.status == FAILED]
            said += [f"left behind: {one}" for one in study.results.rglob(".*")]
            faults += len(said)
            print(f"{number + 1}: {', '.join(dealt)}; {summary.skipped} kept, {len(summary.outcomes)} run again", *said,
                  sep="\n  ", flush=True)  # fmt: skip
    print(", ".join(f"{blow} {count}" for blow, count in counts.items()))
    print(f"{asked.rounds} rounds, {faults} faults")
    return 1 if faults else 0


def _differences(table: pd.DataFrame, expected: pd.DataFrame) -> list[str]:
    try:
        pd.testing.assert_frame_equal(table, expected, check_exact=True)
    except AssertionError as error:
        return [f"another table: {error}"]
    return []


def _environment() -> dict[str, str]:
    return os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}


if __name__ == "__main__":
    sys.exit(main())
