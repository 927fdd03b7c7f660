"""Batching of the engine calls of several recordings that are computed together.

Each recording is a generator. It computes as if it were alone: where it needs an engine call that others may share, it
yields a `Call` and continues with the result. When all recordings wait for a call, calls of the same kind are joined to
one. For a few hundred points an accelerator takes the time of launching its kernels, and these are then launched once.
Which calls are joined depends only on the calls of the recordings, never on time.

Where a device computes while the host goes on, the recordings are two halves: while the device computes the calls of
one and copies their results back, the host decides with the results of the other what it needs next.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from traceback import clear_frames
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

from fingerflow.errors import is_out_of_memory

T = TypeVar("T")
log = logging.getLogger(__name__)

# Methods whose calls may be batched over recordings, in the order in which they are answered. The most frequent and
# shortest calls come first: recordings that need more of them catch up, and the next longer call is again shared by
# all.
_ORDER = (
    "track",
    "follow",
    "outliers",
    "correct",
    "prepare",
    "windows",
    "noise",
    "covered",
    "threshold",
    "contact",
    "fields",
)


class Call(NamedTuple):
    """Engine call, stored as method and arguments so that it may be batched with calls of other recordings."""

    method: Callable[..., Any]
    arguments: tuple[Any, ...]


#: A generator that yields calls, is sent their results, and returns a value.
Steps = Generator[Call, Any, T]


@runtime_checkable
class BatchingEngine(Protocol):
    """Interface of an engine that can compute one method for several recordings in a single call."""

    def kind(self) -> object:
        """Return a value by which engines are grouped: calls of engines of equal value can be computed in one batch."""
        ...

    @property
    def computes_behind(self) -> bool:
        """Return whether a device computes while the host goes on."""
        ...

    def begun(self, method: str, many: Sequence[tuple[Any, ...]]) -> Callable[[], list[Any]]:
        """Begin to compute the engine method named `method` for several recordings in one batch; `many` holds the
        arguments of each recording. Return a function that waits for the results, one for each recording.
        """
        ...


def run_alone(steps: Steps[T]) -> T:
    """Run one recording without batching of engine calls, and return the result of the recording."""
    try:
        call = next(steps)
        while True:
            method, arguments = call
            del call  # frees the images of this call before the recording reads the next ones
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
    """Run recordings in lock-step, with batched engine calls, and return their results.

    An `Exception` in one recording does not stop the others: when all have ended, that of the first recording is
    raised. Anything else, such as Ctrl-C, ends all of them at once.
    """
    results: dict[int, T] = {}
    errors: dict[int, Exception] = {}
    # Largest number of recordings in a call of a method, after a larger call ran out of memory.
    most: dict[str, int] = {}

    def go_on(place: int, resume: Callable[[], Call], waiting: dict[int, Call]) -> None:
        try:
            waiting[place] = resume()
        except StopIteration as end:
            results[place] = end.value
        except Exception as error:
            # The frames of the traceback would keep this recording's memory while others continue.
            clear_frames(error.__traceback__)
            errors[place] = error

    with ExitStack() as closing:
        for steps in many:
            closing.callback(steps.close)
        first: dict[int, Call] = {}
        for place, steps in enumerate(many):
            go_on(place, partial(next, steps), first)
        turns = deque((waiting, _begin_group(waiting, most)) for waiting in _halves(first) if waiting)
        while turns:
            waiting, answers = turns.popleft()
            for place, answer, error in answers:
                steps = many[place]
                go_on(place, partial(steps.send, answer) if error is None else partial(steps.throw, error), waiting)
                del answer, error  # frees the memory of answer and error before the next recording continues
            if waiting:
                turns.append((waiting, _begin_group(waiting, most)))
    if errors:
        raise errors[min(errors)]
    return [results[place] for place in range(len(many))]


def _halves(waiting: dict[int, Call]) -> list[dict[int, Call]]:
    """Return the calls of recordings by recording, in two halves if a device computes all of them while the host goes
    on.
    """
    if not all(_computes_behind(call) for call in waiting.values()):
        return [waiting]
    places = list(waiting)
    middle = -(-len(places) // 2)
    return [{place: waiting[place] for place in half} for half in (places[:middle], places[middle:])]


def _computes_behind(call: Call) -> bool:
    engine = call.method.__self__  # type: ignore[attr-defined]  # of a bound method
    return isinstance(engine, BatchingEngine) and engine.computes_behind


def _next_group(waiting: dict[int, Call]) -> dict[int, Call]:
    """Remove from `waiting` the next calls that can be computed in one batch, and return them by recording.

    The method that comes first in `_ORDER` is computed first.
    """

    def turn(place: int) -> tuple[int, int]:
        return _ORDER.index(waiting[place].method.__name__), place

    first = waiting[min(waiting, key=turn)]
    kind = _batch_key(first)
    return {place: waiting.pop(place) for place in sorted(waiting) if _batch_key(waiting[place]) == kind}


def _batch_key(call: Call) -> object:
    """Return a key of an engine call, from the method's name and the kind of engine: calls with equal keys are computed
    in one batch.
    """
    engine = call.method.__self__  # type: ignore[attr-defined]  # of a bound method
    return call.method.__name__, engine.kind() if isinstance(engine, BatchingEngine) else id(engine)


def _begin_group(waiting: dict[int, Call], most: dict[str, int]) -> Iterator[tuple[int, Any, Exception | None]]:
    """Take the next group of the waiting calls, begin it if a device computes it while the host goes on, and return an
    iterator over recording, result and error of each call, which waits for them.
    """
    group = _next_group(waiting)
    first = next(iter(group.values()))
    begun: Callable[[], list[Any]] | None = None
    if _computes_behind(first) and len(group) <= most.get(first.method.__name__, len(group)):
        # What cannot be begun fails again where errors are dealt with.
        with suppress(Exception):
            begun = _begun(group)
    return _compute_group(group, most, begun)


def _begun(group: dict[int, Call]) -> Callable[[], list[Any]]:
    method = next(iter(group.values())).method
    engine: BatchingEngine = method.__self__  # type: ignore[attr-defined]
    return engine.begun(method.__name__, [call.arguments for call in group.values()])


def _compute_group(
    group: dict[int, Call], most: dict[str, int], begun: Callable[[], list[Any]] | None = None
) -> Iterator[tuple[int, Any, Exception | None]]:
    """Compute a group of calls, in one batch if the engine supports it; yield recording, result and error of each.

    A batch for which memory is too small is halved, and so are those of this method that follow (`most`). `begun` waits
    for a batch that has begun already.
    """
    first = next(iter(group.values())).method
    name, engine = first.__name__, first.__self__  # type: ignore[attr-defined]
    size = most.get(name, len(group))
    if begun is None and len(group) > max(1, size):
        places = list(group)
        for start in range(0, len(places), size):
            yield from _compute_group({place: group[place] for place in places[start : start + size]}, most)
        return
    if begun is not None or (len(group) > 1 and isinstance(engine, BatchingEngine)):
        try:
            results = (begun or _begun(group))()
        except Exception as error:  # calling one recording at a time shows which one fails
            # Log the text of the error: a log record with the error itself would keep its memory.
            if is_out_of_memory(error) and len(group) > 1:
                most[name] = len(group) // 2
                how = f"needs too much memory and is from now on made of {most[name]} at a time"
            else:
                how = "is made one by one"
            log.warning("%s of %d recordings %s: %s", name, len(group), how, repr(error))
        else:
            yield from ((place, result, None) for place, result in zip(group, results, strict=True))
            return
        begun = None  # frees the memory of the failed batch
        if most.get(name, len(group)) < len(group):
            yield from _compute_group(group, most)
            return
    # Repeat outside the handler, because the error keeps the memory of the failed call until its end.
    for place, call in group.items():
        yield place, *_made(call)


def _made(call: Call) -> tuple[Any, Exception | None]:
    try:
        return call.method(*call.arguments), None
    except Exception as error:
        return None, error
