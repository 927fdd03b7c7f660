"""Execution of a study's tasks on Dask, robust against the loss of workers or of the scheduler."""

import logging
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from itertools import chain, islice
from typing import Any, TypeVar

from tqdm import tqdm

from fingerflow.errors import FingerflowError
from fingerflow.kernels.kernel import cores

_IN_FLIGHT = 3  # tasks per worker submitted at a time: one runs, the others are queued
_RENEWED_AFTER = 200  # tasks per worker after which all workers are replaced, which releases leaked memory
_CONNECT = "20s"  # time limit for reaching a scheduler
_LIBRARIES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")  # whose threads a worker limits
_KEPT = "What is finished is kept; run the same command again for the rest"

Task = TypeVar("Task")
Result = TypeVar("Result")


class Interrupted(Exception):
    """Interruption of a run by Ctrl-C or by loss of the scheduler; the message states the cause and what to do."""


def run_on_workers(
    function: Callable[[Task], Result],
    tasks: Iterable[tuple[str, Task]],
    count: int,
    result_of_error: Callable[[str, BaseException], Result],
    scheduler: str | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> Iterator[Result]:
    """Run a function on each task in worker processes of a Dask cluster, and yield the results in the order in which
    tasks finish.

    Args:
        function: of a module, so that a worker can run it.
        tasks: (name, task) with unique names; consumed as capacity becomes free.
        count: number of tasks.
        result_of_error: returns the result for a task that has raised, or whose workers were killed repeatedly.
        scheduler, workers: as in `run_study`.
        progress: show a bar with the remaining time.

    Raises:
        FingerflowError: the cluster is not available.
        Interrupted: Ctrl-C, SIGTERM, or the scheduler is gone.
    """
    worker_count = workers_for(count, workers)
    # A local cluster is replaced after so many tasks, when none is running; other clusters follow their own rules.
    each_round = _RENEWED_AFTER * worker_count if scheduler is None else None
    waiting = iter(tasks)
    with tqdm(total=count, unit="trial", disable=not progress) as bar:
        while (first := next(waiting, None)) is not None:
            of_round = islice(chain([first], waiting), each_round)
            with _client(scheduler, worker_count, threads_each(scheduler, worker_count)) as client:
                for result in _run_tasks(client, function, of_round, result_of_error):
                    bar.update()
                    yield result


def workers_for(count: int, workers: int | None) -> int:
    """Return the number of workers to start for `count` tasks: `workers`, or else one per core of this computer, but at
    most one per task.
    """
    return max(1, min(workers or cores(), count))


def threads_each(scheduler: str | None, workers: int) -> int:
    """Return the number of threads per worker: an equal share of this computer's cores, or 1 on a remote cluster."""
    return max(1, cores() // workers) if scheduler is None else 1


def _run_tasks(
    client: Any,
    function: Callable[[Task], Result],
    tasks: Iterator[tuple[str, Task]],
    result_of_error: Callable[[str, BaseException], Result],
) -> Iterator[Result]:
    from distributed import as_completed

    def submit(running: int) -> list[Any]:
        """Submit tasks until a multiple of the threads of workers, which may come and go, is under way."""
        more = max(2, _IN_FLIGHT * sum(client.nthreads().values())) - running
        # Give all tasks one group name, since a scheduler never discards the statistics of a group.
        following = islice(tasks, max(0, more))
        return [client.submit(function, task, key=f"{prefix}{name}", pure=False) for name, task in following]

    prefix = f"trial-{os.getpid()}-"
    try:
        with _interrupt_on_sigterm():
            if not client.nthreads():
                address = client.scheduler.address
                idle = f"warning: no worker is at {address}, so nothing is processed; waiting until one comes"
                tqdm.write(idle, file=sys.stderr)
            waiting = as_completed(submit(0))
            for future in waiting:
                if future.status == "finished":
                    yield future.result()
                elif future.status == "error":
                    yield result_of_error(future.key.removeprefix(prefix), future.exception())
                else:
                    raise Interrupted(f"the scheduler was lost. {_KEPT}")
                waiting.update(submit(waiting.count()))
    except KeyboardInterrupt:
        raise Interrupted(f"interrupted. {_KEPT}") from None
    except (Interrupted, FingerflowError):
        raise
    except Exception as error:
        # After the scheduler is lost a client raises different errors, depending on its current operation.
        if isinstance(error, (OSError, TimeoutError)) or client.status != "running":
            raise Interrupted(f"the scheduler was lost ({error}). {_KEPT}") from error
        raise


@contextmanager
def _client(scheduler: str | None, workers: int, threads: int) -> Iterator[Any]:
    """Yield a Dask client, closed at the end with the cluster; a scheduler that ran before keeps running."""
    try:
        import dask
        from distributed import Client, LocalCluster, Security
        from distributed.utils import get_mp_context
    except ImportError as error:
        raise FingerflowError(
            f"a study runs on Dask, which is not installed ({error}): pip install 'dask[distributed]' cryptography"
        ) from error
    logging.getLogger("distributed").setLevel(logging.ERROR)
    environment: dict[str, Any] = {f"distributed.nanny.pre-spawn-environ.{name}": threads for name in _LIBRARIES}
    # OpenMP threads spin between operations by default: two of them on a busy machine take four times the processor
    # time and three times as long.
    environment["distributed.nanny.pre-spawn-environ.OMP_WAIT_POLICY"] = os.environ.get("OMP_WAIT_POLICY", "PASSIVE")
    environment |= {
        # Dask has the GNU C library return freed memory at once: each array above 128 kB is then mapped again and its
        # pages are cleared by the system at the first touch, 600 of them per frame. Here a few hundred MB are kept.
        "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": 256 << 20,
        "distributed.nanny.pre-spawn-environ.MALLOC_MMAP_THRESHOLD_": 32 << 20,
        # Client and workers monitor themselves up to 50 times a second, which takes 9 % of a core with two workers;
        # with these intervals it takes less than 2 %.
        "distributed.admin.tick.interval": "1s",
        "distributed.admin.tick.cycle": "2s",
        "distributed.admin.system-monitor.interval": "5s",
        "distributed.worker.memory.monitor-interval": "500ms",
        # A worker's profiler keeps a call tree for every second of the last hour, 0.4 MB per small recording. Logs of
        # messages and transitions serve Dask's developers and take 16 MB in the client and its scheduler.
        "distributed.comm.retry.count": 3,
        "distributed.worker.profile.enabled": False,
        "distributed.admin.low-level-log-length": 100,
    }
    if scheduler is None:
        # Pages of the scheduler and of workers, which list tasks and logs, are open to every user of this computer.
        environment |= {f"distributed.{part}.http.routes": [] for part in ("scheduler", "worker")}
        if sys.platform == "linux":  # elsewhere a process that has loaded torch may not fork
            environment["distributed.worker.multiprocessing-method"] = "forkserver"
    deployment = _deployment(scheduler) if scheduler is not None and "://" not in scheduler else None
    with dask.config.set(environment):
        cluster: Any = None
        try:
            if scheduler is None:
                # Modules are loaded in the process from which workers are forked, not again in each worker.
                context = get_mp_context()
                if context.get_start_method() == "forkserver":
                    context.set_forkserver_preload(["fingerflow.study.preload"])
                # A scheduler executes what it receives. Without a certificate, which only this process and its
                # workers have, every user of this computer could run commands as the user who started the study.
                cluster = LocalCluster(
                    host="127.0.0.1", protocol="tls://", security=Security.temporary(),
                    n_workers=workers, threads_per_worker=1, processes=True, silence_logs=logging.ERROR,
                    # Let the system choose the port: with a fixed one Dask would warn if another study used it.
                    dashboard_address="127.0.0.1:0", scheduler_kwargs={"dashboard": False},
                )  # fmt: skip
            elif deployment is not None:
                cluster = deployment()
                cluster.scale(workers)
            security = getattr(cluster, "security", None)
            client = Client(scheduler if cluster is None else cluster, timeout=_CONNECT, security=security)
        except Exception as error:  # a deployment may raise anything
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
    module, _, name_in_module = name.rpartition(".")
    try:
        deployment: Callable[[], Any] = getattr(import_module(module), name_in_module)
    except (ImportError, AttributeError, ValueError) as error:
        raise FingerflowError(
            f"--scheduler {name}: neither an address such as tcp://host:8786 nor a class that can be imported ({error})"
        ) from error
    return deployment


@contextmanager
def _interrupt_on_sigterm() -> Iterator[None]:
    """Provide a context in which SIGTERM raises KeyboardInterrupt, as Ctrl-C does."""
    try:
        before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    except ValueError:  # signal handlers can be set in the main thread only
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
