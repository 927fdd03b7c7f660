"""Memory growth of a worker process of `fingerflow study` over many small recordings.

1,000 recordings (40 with --quick) of the simulated press, 20 frames of two views of 96 x 96 px, go through one worker,
which is not replaced meanwhile, though a study replaces it after 200. They are one recording on disk under as many
names. A row every tenth of them: own_mb is the worker's own memory (resident and not shared), resident_mb counts pages
of files too. The last row has the slope of a straight line through own_mb from the second tenth on, kB a recording,
with its standard error, and the same of the client, which holds the scheduler.
"""

import sys
import tempfile
import threading
from pathlib import Path
from unittest.mock import patch

import numpy as np
import psutil

from bench.rows import Cell, Row, Skipped, number
from bench.suites.study import write_study
from fingerflow.study.manifest import load_manifest
from fingerflow.study.run_study import run_study
from fingerflow.synthetic import Press

RECORDINGS, QUICK_RECORDINGS = 1000, 40
PRESS = Press(
    n_frames=20,
    frame_rate=20.0,
    frames_before_trigger=1,
    frame_shape=(96, 192),
    finger=(1.3, 1.2),
    semi_axes=(1.1, 1.0),
)


def run(quick: bool) -> list[Row]:
    """Return a row every tenth of the recordings, and the slope."""
    if not sys.platform.startswith("linux"):
        raise Skipped("what a process shares is known on Linux only")
    count = QUICK_RECORDINGS if quick else RECORDINGS
    with tempfile.TemporaryDirectory() as name, patch("fingerflow.study.cluster._RENEWED_AFTER", 10**9):
        folder = Path(name)
        write_study(folder, PRESS, count)
        study = load_manifest(folder)
        watched = _Watch(study.results, count // 10)
        with watched:
            summary = run_study(study, workers=1, progress=False)
    failed = [one.reason for one in summary.outcomes if one.reason]
    if failed or len(summary.outcomes) != count:
        raise RuntimeError(f"{count - len(summary.outcomes) + len(failed)} of {count} trials have failed: {failed[:1]}")
    return [*watched.rows, _slopes(watched.rows[1:])]


class _Watch(threading.Thread):
    """Reading of the worker, the one child that computes, after every ``every`` results."""

    def __init__(self, results: Path, every: int) -> None:
        super().__init__(daemon=True)
        self.rows: list[Row] = []
        self._results, self._every = results, every
        self._over = threading.Event()
        self._worker: psutil.Process | None = None

    def __enter__(self) -> "_Watch":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self.join()

    def run(self) -> None:
        while not self._over.wait(0.2):
            done = sum(1 for _ in self._results.glob("*/row.json"))
            if done >= self._every * (len(self.rows) + 1):
                if self._worker is None:
                    client = psutil.Process()
                    # The process from which it is forked is as large, and a child of the client.
                    self._worker = max(
                        client.children(recursive=True),
                        key=lambda one: (one.ppid() != client.pid, one.memory_info().rss),
                    )
                try:
                    self.rows.append(_row_of(self._worker, done))
                except (psutil.NoSuchProcess, KeyError, OSError):  # the worker may have ended with the last recording
                    return
                print(self.rows[-1], flush=True)


def _row_of(worker: psutil.Process, done: int) -> Row:
    return {
        "recordings": done,
        "own_mb": _own_mb(worker),
        "resident_mb": worker.memory_info().rss / 1e6,
        "client_mb": _own_mb(psutil.Process()),
        "cpu_s": sum(worker.cpu_times()[:2]),
    }


def _own_mb(process: psutil.Process) -> float:
    memory = process.memory_info()
    return float(memory.rss - memory.shared) / 1e6


def _slopes(rows: list[Row]) -> Row:
    done = np.array([number(row, "recordings") for row in rows])
    found: dict[str, Cell] = {"recordings": "slope"}
    for name, kb in (("own_mb", "own_kb_recording"), ("client_mb", "client_kb_recording")):
        values = np.array([number(row, name) for row in rows])
        (slope, _), covariance = np.polyfit(done, values, 1, cov=True)
        found[kb], found[f"{kb}_std"] = 1e3 * float(slope), 1e3 * float(covariance[0, 0] ** 0.5)
    return found
