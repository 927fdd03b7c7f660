"""Recordings computed together: the engine calls that several of them make at the same time become one.

Each recording is a generator. It computes as if it were alone, and where it needs an engine call that others may share
it yields a `Call` and goes on with what that gives. When all recordings wait for a call, those of one kind are answered
at once: an accelerator, whose time for a few hundred points is that of starting its kernels, starts them once for all.
Which calls are joined depends on what the recordings ask for, and not on time.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from traceback import clear_frames
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

T = TypeVar("T")
log = logging.getLogger(__name__)

# The calls that are made all the time, in the order in which they are answered. Those of the smallest steps come first:
# recordings that need more of them catch up, and the next larger step is one of all again.
_ORDER = ("follow", "outliers", "correct", "prepare", "windows", "noise", "threshold", "contact")


class Call(NamedTuple):
    """A method of an engine, one of `_ORDER`, and its arguments by position."""

    method: Callable[..., Any]
    arguments: tuple[Any, ...]


#: A generator that yields calls, is sent their results, and returns a value.
Steps = Generator[Call, Any, T]


@runtime_checkable
class Joining(Protocol):
    """An engine that computes the same method for several recordings in one call."""

    def kind(self) -> object:
        """What engines have in common whose calls can be joined."""
        ...

    def joined(self, method: str, many: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Results of a method for the arguments of several recordings."""
        ...


def run_alone(steps: Steps[T]) -> T:
    """Return what one recording returns; each of its calls is made by itself."""
    try:
        call = next(steps)
        while True:
            method, arguments = call
            del call  # and with it its pictures, before the recording goes on to the next ones
            try:
                answer = method(*arguments)
            except Exception as error:
                call = steps.throw(error)
            else:
                del method, arguments
                call = steps.send(answer)
    except StopIteration as end:
        result: T = end.value
        return result
    finally:
        steps.close()


def run_together(many: Sequence[Steps[T]]) -> list[T]:
    """Return what recordings return that are computed in lock-step.

    An error of one does not touch the others; when all have ended, the first such error is raised. What is no
    `Exception`, as Ctrl-C, ends all of them at once.
    """
    results: dict[int, T] = {}
    errors: dict[int, Exception] = {}
    waiting: dict[int, Call] = {}

    def go_on(place: int, resume: Callable[[], Call]) -> None:
        try:
            waiting[place] = resume()
        except StopIteration as end:
            results[place] = end.value
        except Exception as error:
            clear_frames(error.__traceback__)  # they hold the memory of this recording while others go on
            errors[place] = error

    with ExitStack() as closing:
        for steps in many:
            closing.callback(steps.close)
        for place, steps in enumerate(many):
            go_on(place, partial(next, steps))
        while waiting:
            for place, answer, error in _answers(_next_group(waiting)):
                steps = many[place]
                go_on(place, partial(steps.send, answer) if error is None else partial(steps.throw, error))
                del answer, error  # and what they hold, before the next recording goes on
    if errors:
        raise errors[min(errors)]
    return [results[place] for place in range(len(many))]


def _next_group(waiting: dict[int, Call]) -> dict[int, Call]:
    """Take the calls of the first kind whose turn it is, by recording."""

    def turn(place: int) -> tuple[int, int]:
        return _ORDER.index(waiting[place].method.__name__), place

    first = waiting[min(waiting, key=turn)]
    kind = _kind(first)
    return {place: waiting.pop(place) for place in sorted(waiting) if _kind(waiting[place]) == kind}


def _kind(call: Call) -> object:
    """What calls have in common that are answered at once."""
    engine = call.method.__self__  # type: ignore[attr-defined]  # of a bound method
    return call.method.__name__, engine.kind() if isinstance(engine, Joining) else id(engine)


def _answers(group: dict[int, Call]) -> Iterator[tuple[int, Any, Exception | None]]:
    """Recording, result and error of each call; they are made as one where the engine can."""
    first = next(iter(group.values())).method
    engine = first.__self__  # type: ignore[attr-defined]
    if len(group) > 1 and isinstance(engine, Joining):
        try:
            results = engine.joined(first.__name__, [call.arguments for call in group.values()])
        except Exception as error:  # whose it is shows when each is made by itself
            # Not the error itself: whoever keeps what is logged would keep its memory.
            log.warning("%s of %d recordings is made one by one: %s", first.__name__, len(group), repr(error))
        else:
            yield from ((place, result, None) for place, result in zip(group, results, strict=True))
            return
    # Not before that error is gone, which holds the memory of the call that failed.
    for place, call in group.items():
        yield place, *_made(call)


def _made(call: Call) -> tuple[Any, Exception | None]:
    try:
        return call.method(*call.arguments), None
    except Exception as error:
        return None, error
