"""Tests of tasks on workers: each task is returned once, whatever happens to its worker."""

import os
import sys
import time
from collections.abc import Iterator
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


def test_a_cluster_without_workers_is_waited_for_and_all_that_come_have_work(capfd: pytest.CaptureFixture[str]) -> None:
    """Tasks wait for the first worker; then as many are in flight as the workers that have joined need."""
    requested, said = 0, ""

    def tasks() -> Iterator[tuple[str, int]]:
        nonlocal requested
        for requested in range(1, 21):
            yield f"task-{requested}", requested

    with LocalCluster(  # its workers have one thread each, on any number of cores
        n_workers=0, threads_per_worker=1, processes=False, dashboard_address=None, protocol="tcp://"
    ) as empty:
        waiting: list[int] = []

        def come() -> None:
            nonlocal said
            while "no worker is at tcp://" not in said:
                time.sleep(0.05)
                said += capfd.readouterr().err
            waiting.append(requested)
            empty.scale(4)

        coming = Thread(target=come, daemon=True)
        coming.start()
        results = run_on_workers(_waits, tasks(), 20, _raise, str(empty.scheduler_address), progress=False)
        first = next(results)
        empty.wait_for_workers(4)
        second = next(results)
        assert waiting[0] <= 3
        assert requested >= 13
        found = [first, second, *results]
        coming.join()
    assert sorted(found) == list(range(1, 21))
    assert (said + capfd.readouterr().err).count("no worker is at") == 1


def _asks_as_somebody_else(_: int) -> tuple[str, str, list[str]]:
    """Return the scheduler's address, the outcomes of connecting to it without its certificate, as another user would,
    and its pages, which need none.
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
    return address, " ".join(answers), dask.config.get("distributed.scheduler.http.routes")


def test_nobody_else_is_let_in_by_the_scheduler_of_a_study() -> None:
    """The scheduler, which runs any code that it receives, accepts no connection by TCP or with a foreign
    certificate, and serves no page.
    """
    ((address, answers, pages),) = run_on_workers(
        _asks_as_somebody_else, iter([("task", 1)]), 1, _raise, workers=1, progress=False
    )
    assert address.startswith("tls://127.0.0.1:")
    assert "let in" not in answers
    assert pages == []
