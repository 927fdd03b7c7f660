"""Processes of a study that can be killed, and files that can be damaged."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import psutil

from fingerflow.study.manifest import Manifest
from fingerflow.study.table import write_tables

ROOT = Path(__file__).resolve().parents[2]
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
    return pd.read_parquet(write_tables(study)[0]).drop(columns="result")


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


def _environment() -> dict[str, str]:
    return os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
