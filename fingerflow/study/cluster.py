"""Tasks of a study on Dask: a few in flight, whatever happens to workers and scheduler."""

import logging
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from itertools import chain, islice
from threading import Event, Thread
from typing import Any, TypeVar

from tqdm import tqdm

from fingerflow.errors import FingerflowError

_IN_FLIGHT = 3  # tasks a worker: one that runs, others that wait beside it
_RENEWED_AFTER = 200  # tasks a worker, after which all are replaced by fresh ones: whatever leaks goes with them
_ADDRESS = ("tcp://", "tls://", "ucx://", "ws://", "wss://", "inproc://")
_CONNECT = "20s"  # to reach a scheduler
_LOOK = 5.0  # s between two looks how many workers there are
_KEPT = "What is finished is kept; run the same command again for the rest"

Task = TypeVar("Task")
Result = TypeVar("Result")


class Interrupted(Exception):
    """Ctrl-C, or the scheduler was lost; the message says so, and what to do."""


def cores() -> int:
    """That this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def over_workers(
    act: Callable[[Task], Result],
    tasks: Iterable[tuple[str, Task]],
    count: int,
    of_error: Callable[[str, BaseException], Result],
    scheduler: str | None = None,
    workers: int | None = None,
    progress: bool = True,
    trials_of: Callable[[Result], int] = lambda _: 1,
) -> Iterator[Result]:
    """Results of tasks, as they come.

    Args:
        act: what a worker does; a function of a module.
        tasks: by their names, no two alike; taken when there is room for one.
        count: of the trials, by default one a task.
        of_error: what stands for a task that has raised, or whose workers were killed again and again.
        scheduler, workers: as in `run_study`.
        progress: show a bar with the time that is left.
        trials_of: how many trials a result is of.

    Raises:
        FingerflowError: the cluster cannot be had.
        Interrupted: Ctrl-C, SIGTERM, or the scheduler is gone.
    """
    many = workers_for(count, workers)
    # A local cluster is replaced after so many tasks, when nothing is in flight; another has rules of its own.
    each_round = _RENEWED_AFTER * many if scheduler is None else None
    waiting = iter(tasks)
    with tqdm(total=count, unit="trial", disable=not progress) as bar:
        while (first := next(waiting, None)) is not None:
            of_round = islice(chain([first], waiting), each_round)
            with _client(scheduler, many, threads_each(scheduler, many), act.__module__) as client:
                for result in _go_through(client, act, of_round, of_error):
                    bar.update(trials_of(result))
                    yield result


def workers_for(count: int, workers: int | None) -> int:
    """As many as are asked for, or as there are cores; not more than tasks."""
    return max(1, min(workers or cores(), count))


def threads_each(scheduler: str | None, workers: int) -> int:
    """Threads that a worker computes with: the cores of this computer are shared out, a cluster's workers have one."""
    return max(1, cores() // workers) if scheduler is None else 1


def _go_through(
    client: Any,
    act: Callable[[Task], Result],
    tasks: Iterator[tuple[str, Task]],
    of_error: Callable[[str, BaseException], Result],
) -> Iterator[Result]:
    from distributed import as_completed

    names: dict[str, str] = {}

    def submit(name: str, task: Task) -> Any:
        # All of one group: a scheduler never forgets the statistics that it keeps of each group's name.
        future = client.submit(act, task, key=f"trial-{os.getpid()}-{name}", pure=False)
        names[future.key] = name
        return future

    try:
        with _interrupt_once(), _Workers(client) as workers:
            waiting = as_completed([submit(*one) for one in islice(tasks, workers.room())])
            for future in waiting:
                if future.status == "finished":
                    yield future.result()
                elif future.status == "error":
                    yield of_error(names[future.key], future.exception())
                else:
                    raise Interrupted(f"the scheduler was lost. {_KEPT}")
                del names[future.key]
                for one in islice(tasks, max(0, workers.room() - len(names))):
                    waiting.add(submit(*one))
    except KeyboardInterrupt:
        raise Interrupted(f"interrupted. {_KEPT}") from None
    except (Interrupted, FingerflowError):
        raise
    except Exception as error:
        # What a client raises whose scheduler does not come back depends on what it was about to do.
        if isinstance(error, (OSError, TimeoutError)) or client.status != "running":
            raise Interrupted(f"the scheduler was lost ({error}). {_KEPT}") from error
        raise


class _Workers:
    """How many the workers of a cluster are, which come and go.

    A cluster whose workers have not come yet, or are gone, may get some: it is waited for, and that is said.
    """

    def __init__(self, client: Any) -> None:
        self._client, self._ended = client, Event()
        self._threads: int = sum(client.nthreads().values())

    def __enter__(self) -> "_Workers":
        Thread(target=self._look, name="workers", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()

    def room(self) -> int:
        """Tasks that may be in flight."""
        return max(2, _IN_FLIGHT * self._threads)

    def _look(self) -> None:
        said = False
        while not self._ended.wait(_LOOK):
            try:
                self._threads = sum(self._client.nthreads().values())
                place = self._client.scheduler.address
            except Exception:  # the scheduler is lost, which is said elsewhere
                return
            if not self._threads and not said:
                tqdm.write(
                    f"warning: no worker is at {place}, so nothing is processed; waiting until one comes",
                    file=sys.stderr,
                )
            said = not self._threads


@contextmanager
def _client(scheduler: str | None, workers: int, threads: int, loads: str) -> Iterator[Any]:
    """A client of a cluster; both are closed behind it, a scheduler that was there before is left alone.

    `loads` is the module that a worker of this computer has loaded when it starts.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise FingerflowError(
            f"a study runs on Dask, which is not installed ({error}): pip install 'fingerflow-engine[study]'"
        ) from error
    logging.getLogger("distributed").setLevel(logging.ERROR)
    environment: dict[str, int | str] = {
        f"distributed.nanny.pre-spawn-environ.{name}": threads
        for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    }
    # Threads of OpenMP spin between operations unless told to sleep: two of them on a busy machine take four times the
    # processor, and three times as long.
    environment["distributed.nanny.pre-spawn-environ.OMP_WAIT_POLICY"] = os.environ.get("OMP_WAIT_POLICY", "PASSIVE")
    # Client and workers look at themselves up to 50 times a second: with two workers 9 % of a core, so less than 2 %.
    environment |= {
        "distributed.admin.tick.interval": "1s",
        "distributed.admin.tick.cycle": "2s",
        "distributed.admin.system-monitor.interval": "5s",
        "distributed.worker.memory.monitor-interval": "500ms",
    }
    if scheduler is None and sys.platform == "linux":  # on other systems a process that has loaded torch may not fork
        environment["distributed.worker.multiprocessing-method"] = "forkserver"
    # A worker's profiler keeps a tree of calls for every second of the last hour: 0.4 MB a small recording.
    # Its logs of messages and transitions are for those who mend Dask: 16 MB of the client and its scheduler.
    own = {
        "distributed.comm.retry.count": 3,
        "distributed.worker.profile.enabled": False,
        "distributed.admin.low-level-log-length": 100,
    }
    with dask.config.set({**environment, **own}):
        cluster: Any = None
        try:
            if scheduler is not None and scheduler.startswith(_ADDRESS):
                client = Client(scheduler, timeout=_CONNECT)
            else:
                if scheduler is None:
                    _load_once(loads)
                    cluster = LocalCluster(
                        n_workers=workers, threads_per_worker=1, processes=True, silence_logs=logging.ERROR,
                        # Of no fixed port, which Dask would warn of where another study has it.
                        dashboard_address="127.0.0.1:0", scheduler_kwargs={"dashboard": False},
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


def _load_once(module: str) -> None:
    """Lets workers be forked from one process that has loaded this module: each by itself loads it for seconds."""
    from distributed.utils import get_mp_context

    context = get_mp_context()
    if context.get_start_method() == "forkserver":
        context.set_forkserver_preload(["fingerflow.study.preload", module])


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
