"""A stand-in for a GPU: streams on the processor whose copies are made only when somebody waits for them."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode

from fingerflow.engines.transfers import CudaTransfers


class Stream:
    """Stream of the stand-in: its copies wait in a list until the host or another stream waits for them."""

    def __init__(self, device: "StandIn", name: str) -> None:
        self.device, self.name = device, name
        self.left: list[Callable[[], object]] = []

    def wait_stream(self, other: "Stream") -> None:
        other.run(len(other.left))

    def wait_event(self, event: "Event") -> None:
        event.stream.run(event.left)

    def run(self, count: int) -> None:
        """Make the first copies in the list."""
        for _ in range(min(count, len(self.left))):
            self.left.pop(0)()


class Event:
    """Event of the stand-in: the copies that its stream had in the list when it was recorded."""

    def __init__(self, device: "StandIn") -> None:
        self.device = device

    def record(self, stream: Stream) -> None:
        self.stream = stream
        self.done = False
        stream.left.append(self._note)

    def _note(self) -> None:
        self.done = True

    @property
    def left(self) -> int:
        """Return how many entries of the stream's list lead up to this event."""
        return 0 if self.done else self.stream.left.index(self._note) + 1

    def synchronize(self) -> None:
        self.device.order.append(f"wait for {self.stream.name}")
        self.stream.run(self.left)


class Delayed(TorchDispatchMode):
    """Puts the copies made on a stream into its list."""

    def __init__(self, stream: Stream) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.stream = stream

    def __torch_dispatch__(
        self, operation: Any, types: Any, arguments: tuple[Any, ...] = (), options: dict[str, Any] | None = None
    ) -> Any:
        if operation.name() != "aten::copy_":
            return operation(*arguments, **(options or {}))
        self.stream.device.order.append(f"copy {self.stream.name}")
        self.stream.left.append(lambda: operation(*arguments))
        return arguments[0]


class StandIn:
    """Stands in for the module `torch.cuda`: the computation takes place at once, copies on other streams later.

    Attributes:
        order: what was asked for, in order: copies ahead and back, and waits of the host.
    """

    def __init__(self) -> None:
        self.order: list[str] = []
        self._current = Stream(self, "computation")
        self._names = iter(("ahead", "back"))

    def Stream(self, device: torch.device) -> Stream:
        return Stream(self, next(self._names))

    def Event(self) -> Event:
        return Event(self)

    def current_stream(self, device: torch.device) -> Stream:
        return self._current

    @contextmanager
    def stream(self, stream: Stream) -> Iterator[None]:
        with Delayed(stream):
            yield


def standing_in() -> tuple[CudaTransfers, StandIn]:
    """Return transfers of a stand-in for a GPU, and the stand-in with the order of calls."""
    device = StandIn()
    return CudaTransfers(torch.device("cpu"), device, page_locked=False), device
