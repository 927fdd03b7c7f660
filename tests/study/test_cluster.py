"""Tasks on workers: each comes back once, whatever happens to the worker."""

import os
import time
from typing import Any

import pytest

from fingerflow.errors import FingerflowError
from fingerflow.study import cluster
from fingerflow.study.cluster import over_workers


def _process(number: int) -> tuple[int, int]:
    return number, os.getpid()


def _fails_at_three(number: int) -> int:
    if number == 3:
        raise ValueError("three")
    return number


def _raise(name: str, error: BaseException) -> Any:
    raise error


def test_workers_are_renewed_and_lose_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "_RENEWED_AFTER", 4)
    tasks = ((f"task-{number}", number) for number in range(10))
    found = list(over_workers(_process, tasks, 10, _raise, workers=1, progress=False))
    assert sorted(number for number, _ in found) == list(range(10))
    assert len({process for _, process in found}) == 3, "ten tasks, four a worker"


def _profiled(_: int) -> int:
    from distributed import get_worker

    time.sleep(1.5)  # profiles are put by once a second
    return len(get_worker().profile_history)


def test_workers_keep_no_profile_of_what_they_did() -> None:
    """It would grow for an hour, by 0.4 MB a small recording."""
    tasks = ((f"task-{number}", number) for number in range(2))
    assert list(over_workers(_profiled, tasks, 2, _raise, workers=1, progress=False)) == [0, 0]


def test_a_task_that_raises_has_a_result_of_its_own(scheduler: str) -> None:
    tasks = ((f"task-{number}", number) for number in range(6))
    failed: list[str] = []

    def of_error(name: str, error: BaseException) -> int:
        assert isinstance(error, ValueError)
        failed.append(name)
        return -1

    found = list(over_workers(_fails_at_three, tasks, 6, of_error, scheduler, progress=False))
    assert sorted(found) == [-1, 0, 1, 2, 4, 5]
    assert failed == ["task-3"]


def test_a_deployment_by_the_name_of_its_class() -> None:
    tasks = ((f"task-{number}", number) for number in range(2))
    found = list(over_workers(_process, tasks, 2, _raise, "distributed.LocalCluster", 1, progress=False))
    assert sorted(number for number, _ in found) == [0, 1]


def test_a_scheduler_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "_CONNECT", "1s")
    with pytest.raises(FingerflowError, match=r"no cluster can be had from tcp://127\.0\.0\.1:9"):
        list(over_workers(_process, iter([("task", 1)]), 1, _raise, "tcp://127.0.0.1:9", progress=False))
