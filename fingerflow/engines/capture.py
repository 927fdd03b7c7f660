"""Replay of modules as CUDA graphs: the host starts one graph in place of hundreds of kernels.

A graph is recorded for each signature: the shapes and dtypes of the inputs. It reads and writes buffers of its own,
into which the inputs of a call are copied and out of which its results are.
"""

import logging
from collections import OrderedDict
from collections.abc import Callable, Sequence
from threading import Lock
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.utils._pytree import tree_flatten, tree_map, tree_unflatten

from fingerflow.engines.transfers import as_bytes, places_of
from fingerflow.errors import first_line

# Number of uncaptured calls with the same input shapes before a CUDA graph is captured: many shapes, as those of lost
# points, occur only once.
_AFTER = 2
# Largest number of captured graphs per module, each with memory of its own; the least recently used one is dropped.
_GRAPHS = 8
_one_recording = Lock()  # one capture at a time, since a capture begins with freeing unused memory
log = logging.getLogger("fingerflow.engines")


class RecordedCall(NamedTuple):
    """Recorded torch call: `replay()` computes the tensors in `result` again, from the current content of the tensors
    that the call has read.
    """

    replay: Callable[[], object]
    result: Any


Record = Callable[[Callable[[], Any]], RecordedCall]


def record_graph(call: Callable[[], Any]) -> RecordedCall:
    """Record a call as a CUDA graph with a memory pool of its own.

    Raises:
        RuntimeError: the call waits for the device, or memory is too small.
    """
    current, graph = torch.cuda.current_stream(), torch.cuda.CUDAGraph()
    with _one_recording:
        try:
            ahead = torch.cuda.Stream()
            ahead.wait_stream(current)
            # A first call lets libraries allocate their workspaces, which must not be captured.
            with torch.cuda.stream(ahead):
                call()
            current.wait_stream(ahead)
            # "thread_local" lets other threads use the device during the capture.
            with torch.cuda.graph(graph, capture_error_mode="thread_local"):
                result = call()
        finally:
            torch.cuda.set_stream(current)  # a failed capture leaves its own stream current
    return RecordedCall(graph.replay, result)


class Captured:
    """Wrapper of a torch module that records its calls as CUDA graphs and replays them; other attributes are those of
    the module.

    A call whose signature is new, or cannot be recorded, is an ordinary call of the module. The wrapper may be called
    from several threads. Derivatives are not computed.

    Args:
        module: its results depend on the tensors and numbers that it is given only.
        record: makes a recording of a call.
    """

    def __init__(self, module: nn.Module, record: Record = record_graph) -> None:
        self._module, self._record = module, record
        self._lock = Lock()
        self._calls: dict[Any, int] = {}
        self._graphs: OrderedDict[Any, _Graph | None] = OrderedDict()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._module, name)

    def __call__(self, *given: Any) -> Any:
        """Return the result of the module for the arguments `given`, in new tensors."""
        leaves, structure = tree_flatten(given)
        signature = str(structure), tuple((one.shape, one.dtype) if isinstance(one, Tensor) else one for one in leaves)
        with torch.inference_mode(), self._lock:
            graph = self._graph(signature, given)
            if graph is not None:
                return graph([one for one in leaves if isinstance(one, Tensor)])
        return self._module(*given)

    def _graph(self, signature: Any, given: tuple[Any, ...]) -> "_Graph | None":
        if signature not in self._graphs:
            self._calls[signature] = self._calls.get(signature, 0) + 1
            if self._calls[signature] <= _AFTER:
                return None
            self._graphs[signature] = self._recorded(given)
            if len(self._graphs) > _GRAPHS:
                del self._calls[self._graphs.popitem(last=False)[0]]
        self._graphs.move_to_end(signature)
        return self._graphs[signature]

    def _recorded(self, given: tuple[Any, ...]) -> "_Graph | None":
        try:
            return _Graph(self._module, given, self._record)
        except RuntimeError as error:
            name = type(self._module).__name__
            log.warning("%s is not captured as a graph and computed call by call: %s", name, first_line(error))
            return None


class _Graph:
    """Recorded call of a module with buffers of its own: a call copies new inputs into them, replays the computation,
    whose last nodes write all results into one buffer, and returns views of a copy of it.
    """

    def __init__(self, module: nn.Module, given: tuple[Any, ...], record: Record) -> None:
        own = tree_map(lambda one: one.contiguous().clone() if isinstance(one, Tensor) else one, given)
        self._inputs = [one for one in tree_flatten(own)[0] if isinstance(one, Tensor)]

        def call() -> tuple[Any, list[Any], Tensor]:
            results, structure = tree_flatten(module(*own))
            return structure, results, torch.cat(_padded_bytes(results))

        self._replay, (self._structure, results, self._whole) = record(call)
        self._results = [(one.shape, one.dtype, one.nbytes) if isinstance(one, Tensor) else one for one in results]
        self._places, _ = places_of([one.nbytes for one in results if isinstance(one, Tensor)])

    def __call__(self, given: Sequence[Tensor]) -> Any:
        _copy(self._inputs, given)
        self._replay()
        whole, places = self._whole.clone(), iter(self._places)
        results = [_view(whole, next(places), *one) if isinstance(one, tuple) else one for one in self._results]
        return tree_unflatten(results, self._structure)


def _padded_bytes(results: Sequence[Any]) -> list[Tensor]:
    """Return the bytes of each tensor among the results, padded to where the next one begins by `places_of`."""
    tensors = [one for one in results if isinstance(one, Tensor)]
    places, size = places_of([one.nbytes for one in tensors])
    ends = [*places[1:], size]
    return [
        functional.pad(as_bytes(one), (0, end - place - one.nbytes))
        for one, place, end in zip(tensors, places, ends, strict=True)
    ]


def _view(whole: Tensor, place: int, shape: torch.Size, dtype: torch.dtype, size: int) -> Tensor:
    return whole[place : place + size].view(dtype).view(shape)


def _copy(to: Sequence[Tensor], given: Sequence[Tensor]) -> None:
    """Copy each tensor in `given` into the one at the same place in `to`, with one GPU launch for all whose bytes can
    be copied four at a time, and one for the others.
    """
    pairs = [(as_bytes(own), as_bytes(one)) for own, one in zip(to, given, strict=True)]
    words = [pair for pair in pairs if all(len(one) % 4 == 0 == one.data_ptr() % 4 for one in pair)]
    others = [pair for pair in pairs if not any(pair is one for one in words)]
    for some, dtype in ((words, torch.int32), (others, torch.uint8)):
        if some:
            torch._foreach_copy_([own.view(dtype) for own, _ in some], [one.view(dtype) for _, one in some])
