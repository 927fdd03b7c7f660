"""Count the device operations in one step of a graph, with bytes and operations of each; this needs no accelerator.

The module runs on tensors with shapes and types but no values (torch's device `meta`). An operation that reads a value,
or mixes such tensors with tensors of the host, would make the host wait. An operation that is no view counts as one
call, whether it launches one kernel or several. The count is that of the portable form, eager.

`bytes` of a call are those of the elements that it reads and writes, each once: what it moves if no cache keeps
anything from one call to the next. `flops` are two for each product of a matrix product or a convolution, and one for
each element of any other call.
"""

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.multiprocessing.reductions import StorageWeakRef
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

#: Operations whose result, or its size, depends on values: the host waits for them.
WAITS = frozenset(
    f"aten::{name}"
    for name in (
        *("_local_scalar_dense", "item", "is_nonzero", "equal", "nonzero", "nonzero_numpy", "argwhere"),
        *("masked_select", "_unique", "_unique2", "unique_dim", "unique_consecutive", "bincount"),
        *(
            "repeat_interleave.Tensor",
            "repeat_interleave.self_Tensor",
            "linalg_eigh",
            "_linalg_eigh",
            "linalg_inv",
            "_linalg_check_errors",
        ),
    )
)
_NO_CALLS = frozenset(
    f"aten::{name}" for name in ("empty", "empty_like", "empty_strided", "new_empty", "new_empty_strided", "detach")
)


def is_call(operation: Any) -> bool:
    """Return True if an operation computes on the accelerator: it is neither a view nor an allocation."""
    return not operation.is_view and operation.name().partition(".")[0] not in _NO_CALLS


#: Calls that read as many elements of their first tensor as they return.
_GATHERS = ("aten::gather", "aten::index_select", "aten::index.", "aten::take")
_PRODUCTS = ("aten::matmul", "aten::mm", "aten::bmm", "aten::addmm", "aten::baddbmm")


class HostWait(Exception):
    """Wait of the host in a step that reads a value from the accelerator, or copies one to it."""


class Work(NamedTuple):
    """Work of one call on the accelerator.

    Attributes:
        bytes: that it reads and writes.
        flops: operations.
        programs: that compute it, each on one multiprocessor; None for as many as the accelerator holds.
        cached: bytes that the programs read and write in a cache, beside `bytes`.
    """

    bytes: int
    flops: int
    programs: int | None = None
    cached: int = 0


class Launches(NamedTuple):
    """Number of calls in a step, its result with (shape, type) in place of each tensor, and the work of each call.

    Attributes:
        peak: most bytes alive at a time of tensors that the step makes.
        captured: calls of the host where the step is captured (`engines.capture`): the graph, and copies of its inputs
            and results, one for each dtype.
    """

    calls: int
    result: Any
    work: tuple[Work, ...]
    peak: int
    captured: int


class Counter(TorchDispatchMode):
    """Dispatch mode of torch that counts the calls on tensors without values, with the work of each."""

    def __init__(self, first: bool) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.work: list[Work] = []
        self.peak = 0
        self._alive: dict[StorageWeakRef, int] = {}
        self._first = first

    def __torch_dispatch__(
        self, operation: Any, types: Any, arguments: tuple[Any, ...] = (), options: dict[str, Any] | None = None
    ) -> Any:
        name = operation.name()
        given = [value for value in tree_leaves((arguments, options or {})) if isinstance(value, Tensor)]
        there = any(tensor.is_meta for tensor in given)
        # A scalar of the host is an argument of the call, not a copy.
        mixed = there and any(not tensor.is_meta and tensor.ndim for tensor in given)
        by_mask = name.startswith(("aten::index.", "aten::index_put", "aten::_index_put")) and any(
            isinstance(index, Tensor) and index.dtype == torch.bool for index in arguments[1]
        )
        if there and (mixed or by_mask or name in WAITS):
            raise HostWait(f"{operation}{' by a mask' if by_mask else ' with a tensor of the host' if mixed else ''}")
        result = operation(*arguments, **(options or {}))
        after = [value.is_meta for value in tree_leaves(result) if isinstance(value, Tensor)]
        if name == "aten::detach_" and there and not self._first:  # the one trace of torch.tensor([...], device=...)
            raise HostWait("a tensor made of numbers of the host in every call")
        if given and any(after) and not there and not self._first:
            raise HostWait(f"{operation} brings a constant from the host in every call")
        if any(after) and is_call(operation):
            self.work.append(_work(name, given, [one for one in tree_leaves(result) if isinstance(one, Tensor)]))
        if any(after):
            self._note_memory(given, [one for one in tree_leaves(result) if isinstance(one, Tensor)])
        return result

    def _note_memory(self, given: Sequence[Tensor], results: Sequence[Tensor]) -> None:
        """Add the storages of results that are no views, and forget those that are freed."""
        before = {one.untyped_storage()._cdata for one in given}
        self._alive = {one: size for one, size in self._alive.items() if not one.expired()}
        for one in results:
            storage = one.untyped_storage()
            if storage._cdata not in before:
                self._alive[StorageWeakRef(storage)] = storage.nbytes()
        self.peak = max(self.peak, sum(self._alive.values()))


def _as_it_is(counter: Counter) -> AbstractContextManager[None]:
    return nullcontext()


def count_launches(
    module: nn.Module, inputs: Sequence[Any], within: Callable[[Counter], AbstractContextManager[None]] = _as_it_is
) -> Launches:
    """Count the calls of a module in its second run on inputs that may be nested; the module stays as it is.

    In the first run constants may be brought to the accelerator, which keeps them. `within` returns the context of a
    run, for its counter.

    Raises:
        HostWait: the host would have to wait; the message names the operation.
    """

    def shape_of(value: Any) -> Any:
        return value.to("meta") if isinstance(value, Tensor) else value

    there = {name: shape_of(value) for name, value in (*module.named_parameters(), *module.named_buffers())}
    given = tree_map(shape_of, tuple(inputs))
    with torch.inference_mode(), Counter(first=True) as counter, within(counter):
        torch.func.functional_call(module, there, given)
    with torch.inference_mode(), Counter(first=False) as counter, within(counter):
        result = torch.func.functional_call(module, there, given)
    described = tree_map(
        lambda value: (tuple(value.shape), value.dtype) if isinstance(value, Tensor) else value, result
    )
    kinds = [{one.dtype for one in tree_leaves(some) if isinstance(one, Tensor)} for some in (given, result)]
    return Launches(len(counter.work), described, tuple(counter.work), counter.peak, 1 + sum(map(len, kinds)))


def _work(name: str, given: Sequence[Tensor], results: Sequence[Tensor]) -> Work:
    written = sum(map(bytes_of, results))
    read = [bytes_of(one) for one in given]
    if read and name.startswith(_GATHERS):
        read[0] = min(read[0], written)
    elements = max(one.numel() for one in (*given, *results))
    if name.startswith(_PRODUCTS):
        flops = 2 * results[0].numel() * given[-1].shape[-2 if given[-1].ndim > 1 else -1]
    elif name.startswith(("aten::conv", "aten::_convolution")):
        flops = 2 * results[0].numel() * given[1][0].numel()
    else:
        flops = elements
    return Work(sum(read) + written, flops)


def bytes_of(tensor: Tensor) -> int:
    """Return the bytes of the elements of a tensor; one that several positions share, as in `expand`, counts once."""
    own = math.prod(size for size, step in zip(tensor.shape, tensor.stride(), strict=True) if step or size == 0)
    return min(own * tensor.element_size(), tensor.untyped_storage().nbytes())
