"""Tests of batches that are computed ahead of the current one."""

import threading

import pytest

from fingerflow.pipeline.run import _compute_ahead


def test_results_come_in_order_and_one_is_under_way() -> None:
    """While the first result is in use, the second is computed, but not the third."""
    begun: list[int] = []
    second = threading.Event()

    def act(number: int) -> int:
        begun.append(number)
        if number == 1:
            second.set()
        return 10 * number

    results = _compute_ahead(act, range(5))
    assert next(results) == 0
    assert second.wait(60)
    assert begun == [0, 1]
    assert list(results) == [10, 20, 30, 40]
    assert list(_compute_ahead(act, [])) == []


def test_an_error_comes_after_the_results_before_it() -> None:
    def act(number: int) -> int:
        if number == 2:
            raise OSError("frame 2 is damaged")
        return number

    results = _compute_ahead(act, range(5))
    assert [next(results), next(results)] == [0, 1]
    with pytest.raises(OSError, match="frame 2"):
        next(results)
