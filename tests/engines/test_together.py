"""Tests of recordings computed in lock-step: which calls are joined, and which recording an error belongs to."""

import logging
import weakref
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from fingerflow.engines.together import Call, Steps, run_alone, run_together


class Doubling:
    """An engine that doubles numbers, for at most `room` recordings in one call, at the call or `behind` it, when its
    results are waited for.
    """

    def __init__(self, room: int = 8, behind: bool = False) -> None:
        self.room, self.computes_behind = room, behind
        self.made = list[tuple[str, list[int]]]()
        self.order = list[str]()
        self._taken = list[weakref.ref[Any]]()

    def kind(self) -> object:
        return self.room

    def begun(self, method: str, many: Sequence[tuple[int]]) -> Callable[[], list[int]]:
        taken = np.zeros(len(many))  # memory of the call
        self._taken.append(weakref.ref(taken))
        if len(many) > self.room:
            raise MemoryError(f"no room for {taken}")
        values = [value for (value,) in many]
        self.order.append(f"begin {values}")

        def results() -> list[int]:
            self.order.append(f"wait {values}")
            return self._doubled(method, values)

        return results

    def follow(self, value: int) -> int:
        assert all(taken() is None for taken in self._taken), "memory of a call of all is not free"
        return self._doubled("follow", [value])[0]

    def correct(self, value: int) -> int:
        return self._doubled("correct", [value])[0]

    def _doubled(self, method: str, values: list[int]) -> list[int]:
        if min(values) < 0:
            raise ValueError(f"{values} in {method}")
        self.made.append((method, values))
        return [2 * value for value in values]


def followed(engine: Doubling, value: int, times: int = 1) -> Steps[int]:
    for _ in range(times):
        value = yield Call(engine.follow, (value,))
    return value


def corrected(engine: Doubling, value: int, times: int) -> Steps[int]:
    value = yield from followed(engine, value, times)
    return (yield Call(engine.correct, (value,)))


def test_calls_are_one_until_a_recording_ends() -> None:
    engine = Doubling()
    assert run_together([followed(engine, 1, times) for times in (3, 1, 2)]) == [8, 2, 4]
    assert engine.made == [("follow", [1, 1, 1]), ("follow", [2, 2]), ("follow", [4])]
    assert [run_alone(followed(engine, 1, times)) for times in (3, 1, 2)] == [8, 2, 4]
    assert run_together([]) == []


def test_recordings_with_more_steps_catch_up_before_the_next_joined_call() -> None:
    engine = Doubling()
    assert run_together([corrected(engine, 1, 3), corrected(engine, 5, 1)]) == [16, 20]
    assert engine.made == [("follow", [1, 5]), ("follow", [2]), ("follow", [4]), ("correct", [8, 10])]


def test_a_device_computes_for_one_half_while_the_host_decides_for_the_other() -> None:
    """Where a device computes behind, results are waited for only after the next calls of the other half have begun;
    the results are those of recordings one by one, and equal from run to run.
    """
    engine = Doubling(behind=True)
    assert run_together([followed(engine, value, 3) for value in (1, 10, 100)]) == [8, 80, 800]
    assert engine.order == [
        *("begin [1, 10]", "begin [100]", "wait [1, 10]", "begin [2, 20]", "wait [100]", "begin [200]"),
        *("wait [2, 20]", "begin [4, 40]", "wait [200]", "begin [400]", "wait [4, 40]", "wait [400]"),
    ]


@pytest.mark.parametrize("room", [1, 2, 3])
def test_calls_behind_that_need_too_much_memory_are_halved(room: int) -> None:
    engine = Doubling(room, behind=True)
    found = run_together([followed(engine, value, 2) for value in range(1, 9)])
    assert found == [4 * value for value in range(1, 9)]
    assert [len(values) for _, values in engine.made] == [max(1, room // 2 * 2)] * (16 // max(1, room // 2 * 2))


def test_an_error_behind_is_of_the_recording_that_it_comes_from() -> None:
    engine = Doubling(behind=True)
    with pytest.raises(ValueError, match="-2"):
        run_together([followed(engine, 3, 3), followed(engine, -2), followed(engine, 5, 2), followed(engine, 7, 2)])
    assert engine.made[-1] == ("follow", [12])


def test_engines_of_other_kinds_are_asked_by_themselves() -> None:
    one, other = Doubling(3), Doubling(4)
    assert run_together([followed(one, 1), followed(other, 2), followed(one, 3)]) == [2, 4, 6]
    assert [one.made, other.made] == [[("follow", [1, 3])], [("follow", [2])]]


def test_recordings_are_computed_one_by_one_where_memory_is_too_small_for_all() -> None:
    engine = Doubling(1)
    assert run_together([followed(engine, 3), followed(engine, 4)]) == [6, 8]
    assert engine.made == [("follow", [3]), ("follow", [4])]


def test_calls_that_need_too_much_memory_are_halved(caplog: pytest.LogCaptureFixture) -> None:
    """Joined calls that need too much memory are halved until they fit, and stay so; each size is named in one
    warning.
    """
    engine = Doubling(3)
    with caplog.at_level(logging.WARNING):
        found = run_together([followed(engine, value, 2) for value in range(1, 9)])
    assert found == [4 * value for value in range(1, 9)]
    assert [len(values) for _, values in engine.made] == [2] * 8
    assert [message.split(":")[0] for message in caplog.messages] == [
        f"follow of {size} recordings needs too much memory and is from now on made of {size // 2} at a time"
        for size in (8, 4)
    ]


def test_an_error_is_of_the_recording_that_it_comes_from() -> None:
    """An error ends only the recording that it comes from, which may catch it and go on; the first uncaught error is
    raised when all recordings have ended.
    """
    engine = Doubling()

    def forgiving() -> Steps[int]:
        try:
            return (yield from followed(engine, -1))
        except ValueError:
            return (yield from followed(engine, 5, 2))

    assert run_together([followed(engine, 3), forgiving()]) == [6, 20]
    assert run_alone(forgiving()) == 20
    engine.made.clear()
    with pytest.raises(ValueError, match="-2"):
        run_together([followed(engine, 3, 3), followed(engine, -2), followed(engine, -4)])
    assert engine.made[-1] == ("follow", [12])


def test_what_a_recording_holds_is_free_when_it_has_failed() -> None:
    engine, held, seen = Doubling(), list[weakref.ref[Any]](), list[bool]()

    def failing() -> Steps[None]:
        taken = np.zeros(3)
        held.append(weakref.ref(taken))
        yield Call(engine.follow, (-int(taken.size),))

    def looking() -> Steps[None]:
        yield from followed(engine, 1, 2)
        seen.append(held[0]() is None)

    with pytest.raises(ValueError, match="-3"):
        run_together([failing(), looking()])
    assert seen == [True]


@pytest.mark.parametrize("run", [lambda steps: run_together([steps, steps]), run_alone])
def test_an_interrupt_ends_all(run: Any) -> None:
    ended = list[str]()

    class Interrupted(Doubling):
        def _doubled(self, method: str, values: list[int]) -> list[int]:
            raise KeyboardInterrupt

    def recording() -> Steps[None]:
        try:
            yield from followed(Interrupted(), 1)
        finally:
            ended.append("closed")

    with pytest.raises(KeyboardInterrupt):
        run_alone(recording()) if run is run_alone else run_together([recording(), recording()])
    assert ended == ["closed"] * (1 if run is run_alone else 2)
