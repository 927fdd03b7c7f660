"""Run time of a study of many recordings, from files to a table of trials: `fingerflow study` and a loop over OpenCV.

40 recordings of the simulated press, 300 frames of two 512 x 640 px views each (4 of 24 small frames with --quick).
They are one recording on disk under as many names, so that pages of files come from memory for both. All outputs are
computed and written to files; OpenCV's pipeline (`bench/opencv_pipeline.py`) gives contact, tracks and strain, and
writes nothing. Both run in two processes of one thread each.

`frames_per_s` is by the clock, from the start of the command to the end: to be read on an idle machine alone.
`cpu_ms_frame` is the processors' time of all processes over the frames, starting and loading of the workers included;
`in_trials_ms_frame` of it what workers spent within trials. `to_peer` is cpu_ms_frame of OpenCV over that of the row.
`load` is how many processes the machine had to run on average when the row ended.

`plan_ms_trial` is what the client spends on a trial that is done already: reading the manifest, looking whether
anything of the trial has changed, and writing the tables.

Rows `empty tasks` are tasks that do nothing: what client and scheduler spend on each, and with that the recordings a
second that one scheduler can give out, and how many workers of one thread keep it busy at the measured time of a trial.
"""

import multiprocessing
import os
import resource
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import forkserver
from pathlib import Path

import cv2
import torch
from distributed import LocalCluster

from bench.recordings import QUICK_PRESS, write_quietly
from bench.rows import Row, number
from bench.suites.pipeline import opencv_cpu_ms
from fingerflow.study.cluster import run_on_workers
from fingerflow.study.init import init_study
from fingerflow.study.manifest import load_manifest
from fingerflow.study.run_study import plan_run, run_study
from fingerflow.study.table import write_tables
from fingerflow.synthetic import Press

RECORDINGS, QUICK_RECORDINGS = 40, 4
EMPTY_TASKS, QUICK_EMPTY_TASKS = 4000, 200
WORKERS = 2


def run(quick: bool) -> list[Row]:
    """Return rows of the study with two workers and with one, of OpenCV, and of empty tasks."""
    count = QUICK_RECORDINGS if quick else RECORDINGS
    press = QUICK_PRESS if quick else Press()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        first = write_study(folder, press, count)
        rows = [_study(folder, press, count, workers) for workers in ((WORKERS,) if quick else (WORKERS, 1))]
        peer = _opencv(first, press, count)
    rows = [*rows, peer]
    for row in rows:
        row["to_peer"] = number(peer, "cpu_ms_frame") / number(row, "cpu_ms_frame")
    trial_s = number(rows[0], "in_trials_ms_frame") * press.n_frames / 1e3
    return [*rows, _empty_tasks(QUICK_EMPTY_TASKS if quick else EMPTY_TASKS, trial_s)]


def write_study(folder: Path, press: Press, count: int) -> Path:
    """Write a study of one recording under ``count`` names; return the folder of the first."""
    first = folder / "p01/0um/trial0001"
    write_quietly(first, press)
    for trial in range(2, count + 1):
        other = folder / f"p01/0um/trial{trial:04d}"
        other.mkdir()
        for file in first.iterdir():
            os.link(file, other / file.name)
    init_study(folder)
    return first


def _study(folder: Path, press: Press, count: int, workers: int) -> dict[str, str | float]:
    shutil.rmtree(folder / "results", ignore_errors=True)  # of the row before
    with _used() as used:
        study = load_manifest(folder)
        summary = run_study(study, workers=workers, progress=False)
        write_tables(study)
    start = time.process_time()
    study = load_manifest(folder)
    if plan_run(study):
        raise RuntimeError("a study that is done would be run again")
    write_tables(study)
    again = 1e3 * (time.process_time() - start) / count
    found = [one.made["cpu_seconds"] for one in summary.outcomes.values() if not one.reason]
    if len(found) != count:
        raise RuntimeError(f"{len(found)} of {count} trials were measured: {summary}")
    frames = count * press.n_frames
    measured = {"in_trials_ms_frame": 1e3 * sum(found) / frames, "plan_ms_trial": again}
    return _row("fingerflow study", workers, count, frames, used) | measured


def _opencv(recording: Path, press: Press, count: int) -> dict[str, str | float]:
    context = multiprocessing.get_context("spawn")
    with _used() as used, context.Pool(WORKERS, initializer=_one_thread) as pool:
        spent = pool.starmap(opencv_cpu_ms, [(recording, press)] * count, chunksize=1)
        pool.close()
        pool.join()
    frames = count * press.n_frames
    return _row("opencv", WORKERS, count, frames, used) | {"in_trials_ms_frame": sum(spent) / count}


def _one_thread() -> None:
    cv2.setNumThreads(1)
    torch.set_num_threads(1)


def _nothing(_: int) -> int:
    return 0


def _empty_tasks(count: int, trial_s: float) -> dict[str, str | float]:
    """Measure client and scheduler, which share this process; the worker's time is that of another process."""
    spent = []
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        for many in (count // 10, count):  # what starting takes falls out of the difference
            tasks = ((f"empty-{many}-{one}", one) for one in range(many))
            start = time.process_time()
            for _ in run_on_workers(_nothing, tasks, many, _raise, cluster.scheduler_address, progress=False):
                pass
            spent.append(time.process_time() - start)
    each = (spent[1] - spent[0]) / (count - count // 10)
    return {
        "what": "empty tasks",
        "workers": 1,
        "recordings": count,
        "scheduler_ms_task": 1e3 * each,
        "most_recordings_per_s": 1 / each,
        "workers_that_fill_it": trial_s / each,
        "load": os.getloadavg()[0],
    }


def _raise(name: str, error: BaseException) -> int:
    raise error


@contextmanager
def _used() -> Iterator[dict[str, float]]:
    """Yield a record that holds, afterwards, wall-clock and processor seconds, ended child processes included."""
    found: dict[str, float] = {}
    before, start = _processors(), time.perf_counter()
    yield found
    # Workers are children of the fork server and count once it has ended; the next row starts another.
    forkserver._forkserver._stop()  # type: ignore[attr-defined]
    found |= {"seconds": time.perf_counter() - start, "cpu": _processors() - before}


def _processors() -> float:
    both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(one.ru_utime + one.ru_stime for one in both)


def _row(what: str, workers: int, count: int, frames: int, used: dict[str, float]) -> dict[str, str | float]:
    return {
        "what": what,
        "workers": workers,
        "recordings": count,
        "frames": frames,
        "seconds": used["seconds"],
        "frames_per_s": frames / used["seconds"],
        "cpu_ms_frame": 1e3 * used["cpu"] / frames,
        "load": os.getloadavg()[0],
    }
