"""Which trials are to be run and why, and running them on Dask."""

import logging
import os
import signal
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from importlib import import_module
from itertools import islice
from typing import Any

from tqdm import tqdm

from fingerflow.errors import FingerflowError
from fingerflow.study.files import FAILED, MEASURED, Part, TrialRow, read_row, write_row
from fingerflow.study.keys import code_of, keys_of
from fingerflow.study.manifest import Manifest, TrialEntry
from fingerflow.study.trial import Job, Outcome, changed_inputs, is_current, run_trial

_IN_FLIGHT = 3  # tasks a thread: one that runs, others that wait beside it
_RENEWED_AFTER = 200  # recordings, after which a worker is replaced by a fresh one: whatever leaks goes with it
_ADDRESS = ("tcp://", "tls://", "ucx://", "ws://", "wss://", "inproc://")


@dataclass(frozen=True)
class Planned:
    """A trial that is to be run: from which part on, and why."""

    entry: TrialEntry
    redo: Part
    why: str


@dataclass
class Summary:
    """How a run ended: outcomes by status, what failed and why, and whether it was interrupted."""

    planned: int
    skipped: int
    outcomes: list[Outcome] = field(default_factory=list)
    interrupted: str = ""

    def __str__(self) -> str:
        """A line of counts, and one for each failure."""
        counts = Counter(one.status for one in self.outcomes)
        left = self.planned - len(self.outcomes)
        lines = [
            f"{counts[MEASURED]} trials measured, {counts[FAILED]} failed, {self.skipped} were done already"
            + (f", {left} not run" if left else "")
        ]
        lines += [
            f"  {one.name}: {one.reason}{' (is tried again by the next run)' if one.passing else ''}"
            for one in self.outcomes
            if one.status == FAILED
        ]
        return "\n".join(lines + ([f"stopped: {self.interrupted}"] if self.interrupted else []))


def plan_run(manifest: Manifest, only: str | None = None, retry_failed: bool = False) -> list[Planned]:
    """The trials that have no result of what they are now made of, in the order of the manifest.

    Args:
        manifest: the study.
        only: a pattern of names of trials such as "p03_*"; the others are left as they are.
        retry_failed: also those that failed, though nothing of them has changed.

    Raises FingerflowError where `only` fits no trial.
    """
    entries = [entry for entry in manifest.trials if only is None or fnmatchcase(entry.name, only)]
    if not entries:
        names = ", ".join(entry.name for entry in manifest.trials[:3])
        raise FingerflowError(f"--only {only}: no trial has such a name; they are {names} ...")
    found = (_why(manifest, entry, retry_failed) for entry in entries)
    return [one for one in found if one is not None]


def run_study(
    manifest: Manifest,
    scheduler: str | None = None,
    workers: int | None = None,
    only: str | None = None,
    retry_failed: bool = False,
    progress: bool = True,
) -> Summary:
    """Runs what `plan_run` says, on processes of this computer or on a cluster.

    Each task is one trial. What is finished stands in the folder of the results, whatever happens afterwards: Ctrl-C,
    or the loss of a worker or of the scheduler, end the run and lose nothing of it.

    Args:
        manifest: the study.
        scheduler: the address of a Dask scheduler, or the class of a deployment by its name, such as
            "dask_jobqueue.SLURMCluster", which takes its settings from Dask's own configuration. None for a cluster
            of processes on this computer.
        workers: processes; by default a core each. Cores that are left over become threads of each.
        only, retry_failed: as in `plan_run`.
        progress: show a bar.

    Raises FingerflowError where the cluster cannot be had.
    """
    planned = plan_run(manifest, only, retry_failed)
    chosen = [entry for entry in manifest.trials if only is None or fnmatchcase(entry.name, only)]
    summary = Summary(len(planned), len(chosen) - len(planned))
    if not planned:
        return summary
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    workers = max(1, min(workers or cores, len(planned)))
    threads = max(1, cores // workers) if scheduler is None else 1
    codes = {part: code_of(part) for part in ("pictures", "numbers", "row")}
    jobs = (Job(replace(manifest, trials=(one.entry,)), one.entry, one.redo, codes, threads) for one in planned)
    with (
        _client(scheduler, workers, threads) as client,
        tqdm(total=len(planned), unit="trial", disable=not progress) as bar,
    ):
        for outcome in _go_through(client, jobs, summary, manifest):
            summary.outcomes.append(outcome)
            bar.update()
            bar.set_postfix_str(f"{sum(one.status == FAILED for one in summary.outcomes)} failed", refresh=False)
    return summary


def _why(manifest: Manifest, entry: TrialEntry, retry_failed: bool) -> Planned | None:
    folder = manifest.results / entry.name
    stored = read_row(folder)
    if stored is None:
        return Planned(entry, "pictures", "has not been run" if not folder.exists() else "has no row")
    if stored.status == FAILED and (stored.passing or retry_failed):
        return Planned(entry, "pictures", f"failed: {stored.reason}")
    try:
        keys = keys_of(manifest.scene_of(entry), None if stored.keys is None else stored.keys.inputs)
    except FingerflowError as error:
        # It would fail in the same words again; a row that says so already is all there can be.
        return None if stored.reason == str(error) else Planned(entry, "pictures", f"cannot be run: {error}")
    if stored.keys is None:
        return Planned(entry, "pictures", "could not be opened last time")
    if is_current(stored, keys, folder):
        return None
    changed = changed_inputs(stored.keys, keys)
    if changed:
        return Planned(entry, "pictures", f"{', '.join(changed)} changed")
    if stored.keys.pictures != keys.pictures:
        return Planned(entry, "pictures", "settings or code of contact and tracking changed")
    if stored.status == FAILED:
        return Planned(entry, "pictures", "settings or code changed since it failed")
    if stored.result is None or not (folder / stored.result).exists():
        return Planned(entry, "pictures", "its result is gone")
    if stored.keys.numbers != keys.numbers:
        return Planned(entry, "numbers", "settings or code of fields, strain or slip changed; tracks are kept")
    return Planned(entry, "row", "the table has other columns now; the result is kept")


def _go_through(client: Any, jobs: Iterator[Job], summary: Summary, manifest: Manifest) -> Iterator[Outcome]:
    """Outcomes as they come, a few tasks a thread in flight."""
    from distributed import as_completed

    in_flight = max(2, _IN_FLIGHT * max(1, sum(client.nthreads().values())))
    names: dict[str, TrialEntry] = {}

    def submit(job: Job) -> Any:
        future = client.submit(_task, job, key=f"trial-{job.entry.name}-{os.getpid()}", pure=False)
        names[future.key] = job.entry
        return future

    waiting = as_completed([submit(job) for job in islice(jobs, in_flight)])
    try:
        with _interrupt_once():
            for future in waiting:
                if future.status == "finished":
                    yield future.result()
                elif future.status == "error":
                    yield _of_error(future.exception(), names[future.key], manifest)
                else:
                    summary.interrupted = (
                        "the scheduler was lost. What is finished is kept; run the same command again for the rest"
                    )
                    return
                for job in islice(jobs, 1):
                    waiting.add(submit(job))
    except KeyboardInterrupt:
        summary.interrupted = "interrupted. What is finished is kept; run the same command again for the rest"
    except (OSError, TimeoutError) as error:  # a connection that broke
        summary.interrupted = f"the scheduler was lost ({error}). What is finished is kept; run the same command again"


def _of_error(error: BaseException, entry: TrialEntry, manifest: Manifest) -> Outcome:
    """Of a task that no worker could bring to an end. Raises FingerflowError where the worker itself is at fault."""
    from distributed import KilledWorker

    if isinstance(error, KilledWorker):
        reason = (
            "every worker that took it was killed, as where memory is too small: give fewer workers, or ask why in "
            "their logs"
        )
        write_row(manifest.results / entry.name, TrialRow(FAILED, reason, passing=True))
        return Outcome(entry.name, FAILED, reason, passing=True)
    if isinstance(error, FingerflowError):
        raise error
    return Outcome(entry.name, FAILED, f"unexpected {type(error).__name__}: {error}", passing=True)


_done_here = 0  # of this worker


def _task(job: Job) -> Outcome:
    """What a worker does: a trial, and after many of them it makes place for a fresh worker."""
    global _done_here
    outcome = run_trial(job)
    _done_here += 1
    if _done_here == _RENEWED_AFTER:
        from distributed import get_worker

        worker = get_worker()
        if worker.nanny:  # which starts another one
            worker.loop.add_callback(worker.close_gracefully, restart=True)
    return outcome


@contextmanager
def _client(scheduler: str | None, workers: int, threads: int) -> Iterator[Any]:
    """A client of a cluster; both are closed behind it, a scheduler that was there before is left alone."""
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise FingerflowError(
            f"a study runs on Dask, which is not installed ({error}): pip install 'fingerflow-engine[study]'"
        ) from error
    logging.getLogger("distributed").setLevel(logging.ERROR)
    environment = {
        f"distributed.nanny.pre-spawn-environ.{name}": threads
        for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    }
    with dask.config.set({**environment, "distributed.comm.retry.count": 3}):
        cluster: Any = None
        try:
            if scheduler is not None and scheduler.startswith(_ADDRESS):
                client = Client(scheduler, timeout="20s")
            else:
                if scheduler is None:
                    cluster = LocalCluster(
                        n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None,
                        silence_logs=logging.ERROR,
                    )  # fmt: skip
                else:
                    cluster = _deployment(scheduler)()
                    cluster.scale(workers)
                client = Client(cluster)
        except FingerflowError:
            raise
        except Exception as error:  # whatever a deployment raises
            raise FingerflowError(
                f"no cluster can be had{f' from {scheduler}' if scheduler else ''} ({error or type(error).__name__}); "
                f"look whether its scheduler runs and can be reached from here"
            ) from error
        try:
            yield client
        finally:
            client.close(timeout=5)
            if cluster is not None:
                cluster.close(timeout=10)


def _deployment(name: str) -> Callable[[], Any]:
    module, _, kind = name.rpartition(".")
    try:
        found: Callable[[], Any] = getattr(import_module(module), kind)
    except (ImportError, AttributeError, ValueError) as error:
        raise FingerflowError(
            f"--scheduler {name}: neither an address such as tcp://host:8786 nor a class that can be imported ({error})"
        ) from error
    return found


@contextmanager
def _interrupt_once() -> Iterator[None]:
    """SIGTERM ends a run as Ctrl-C does."""

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    try:
        before = signal.signal(signal.SIGTERM, stop)
    except ValueError:  # not in the main thread
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
