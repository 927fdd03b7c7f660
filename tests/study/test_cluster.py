"""Tests of tasks on workers: each task is returned once, whatever happens to its worker."""

import os
import socket
import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import suppress
from threading import Thread
from typing import Any

import dask
import pytest
from distributed import Client, LocalCluster

from fingerflow.errors import FingerflowError
from fingerflow.study import cluster
from fingerflow.study.cluster import run_on_workers

pytestmark = pytest.mark.long


def _process(number: int) -> tuple[int, int, int]:
    return number, os.getpid(), os.getppid()


def _settings(_: int) -> tuple[str | None, str]:
    return os.environ.get("OMP_WAIT_POLICY"), dask.config.get("distributed.admin.tick.interval")


def _fails_at_three(number: int) -> int:
    if number == 3:
        raise ValueError("three")
    return number


def _waits(number: int) -> int:
    time.sleep(0.1)
    return number


def _raise(name: str, error: BaseException) -> Any:
    raise error


def test_workers_are_renewed_from_one_process_and_lose_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "_RENEWED_AFTER", 4)
    tasks = ((f"task-{number}", number) for number in range(10))
    found = list(run_on_workers(_process, tasks, 10, _raise, workers=1, progress=False))
    assert sorted(number for number, _, _ in found) == list(range(10))
    assert len({process for _, process, _ in found}) == 3, "ten tasks, four a worker"
    parents = {parent for _, _, parent in found}
    if sys.platform == "linux":
        assert len(parents) == 1, "all are forked from the process that has loaded what they need"
        assert os.getpid() not in parents


def _kept(_: int) -> tuple[int, int | None]:
    from distributed import get_worker

    time.sleep(1.5)  # profiles are stored once a second
    return len(get_worker().profile_history), get_worker().state.log.maxlen


def test_little_is_kept_of_what_was_done() -> None:
    """Workers keep no profiles and short logs; profiles would grow by 0.4 MB per small recording for an hour, logs up
    to 1,000 messages.
    """
    tasks = ((f"task-{number}", number) for number in range(2))
    with socket.socket() as other, warnings.catch_warnings():
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with suppress(OSError):  # another study may run here
            other.bind(("127.0.0.1", 8787))
            other.listen()
        warnings.simplefilter("error", UserWarning)  # the port of Dask's dashboard is in use
        assert list(run_on_workers(_kept, tasks, 2, _raise, workers=1, progress=False)) == [(0, 100)] * 2


def test_a_scheduler_keeps_nothing_of_a_name(scheduler: str) -> None:
    """All keys have one prefix: the scheduler never forgets prefixes, and would grow with every trial."""
    tasks = ((f"01_{number}um_1", number) for number in range(3))
    list(run_on_workers(_process, tasks, 3, _raise, scheduler, progress=False))
    with Client(scheduler) as client:
        assert client.run_on_scheduler(lambda dask_scheduler: list(dask_scheduler.task_prefixes)) == ["trial"]


def test_a_task_that_raises_has_a_result_of_its_own(scheduler: str) -> None:
    tasks = ((f"task-{number}", number) for number in range(6))
    failed: list[str] = []

    def of_error(name: str, error: BaseException) -> int:
        assert isinstance(error, ValueError)
        failed.append(name)
        return -1

    found = list(run_on_workers(_fails_at_three, tasks, 6, of_error, scheduler, progress=False))
    assert sorted(found) == [-1, 0, 1, 2, 4, 5]
    assert failed == ["task-3"]


def test_a_deployment_by_the_name_of_its_class(monkeypatch: pytest.MonkeyPatch) -> None:
    """A deployment named by its class has workers whose waiting threads sleep, and that monitor themselves once a
    second.
    """
    monkeypatch.delenv("OMP_WAIT_POLICY", raising=False)
    tasks = ((f"task-{number}", number) for number in range(2))
    found = list(run_on_workers(_settings, tasks, 2, _raise, "distributed.LocalCluster", 1, progress=False))
    assert found == [("PASSIVE", "1s")] * 2


def test_a_scheduler_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "_CONNECT", "1s")
    with pytest.raises(FingerflowError, match=r"no cluster can be had from tcp://127\.0\.0\.1:9"):
        list(run_on_workers(_process, iter([("task", 1)]), 1, _raise, "tcp://127.0.0.1:9", progress=False))


def test_a_cluster_without_workers_is_waited_for_and_all_that_come_have_work(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Tasks wait for the first worker; then one task per thread and two more are in flight, for all workers that have
    joined.
    """
    monkeypatch.setattr(cluster, "_LOOK", 0.05)
    said = ""
    asked = 0

    def tasks() -> Iterator[tuple[str, int]]:
        nonlocal asked
        for asked in range(1, 21):
            yield f"task-{asked}", asked

    with LocalCluster(  # its workers have one thread each, on any number of cores
        n_workers=0, threads_per_worker=1, processes=False, dashboard_address=None, protocol="tcp://"
    ) as empty:

        def come() -> None:
            nonlocal said
            while "no worker is at tcp://" not in said:
                time.sleep(0.05)
                said += capfd.readouterr().err
            empty.scale(4)

        looks: list[int] = []
        nthreads = Client.nthreads

        def noted(client: Client) -> Any:
            found = nthreads(client)
            looks.append(sum(found.values()))
            return found

        monkeypatch.setattr(Client, "nthreads", noted)
        coming = Thread(target=come, daemon=True)
        coming.start()
        results = run_on_workers(_waits, tasks(), 20, _raise, str(empty.scheduler_address), progress=False)
        first = next(results)
        assert asked <= 3
        deadline = time.monotonic() + 60
        while looks.count(4) < 2:  # the second task uses the result of the first
            assert time.monotonic() < deadline, looks
            time.sleep(0.05)
        second = next(results)
        assert asked >= 13
        found = [first, second, *results]
        coming.join()
    assert sorted(found) == list(range(1, 21))
    assert said.count("no worker is at") == 1


def _asks_as_somebody_else(_: int) -> tuple[str, str]:
    """Return the scheduler's address, and the outcomes of connecting to it without its certificate, as another user
    would.
    """
    from distributed import Security, get_worker

    address, answers = get_worker().scheduler.address, []
    for security in (None, Security.temporary()):
        try:
            with dask.config.set({"distributed.comm.timeouts.connect": "2s"}):
                Client(address if security else address.replace("tls://", "tcp://"), security=security, timeout=3)
            answers.append("let in")
        except Exception as error:
            answers.append(type(error).__name__)
    return address, " ".join(answers)


def test_nobody_else_is_let_in_by_the_scheduler_of_a_study() -> None:
    """The scheduler, which runs any code that it receives, accepts no connection by TCP or with a foreign
    certificate.
    """
    ((address, answers),) = run_on_workers(
        _asks_as_somebody_else, iter([("task", 1)]), 1, _raise, workers=1, progress=False
    )
    assert address.startswith("tls://127.0.0.1:")
    assert "let in" not in answers
