"""How often a step of a graph calls an accelerator, counted without one.

The module runs on tensors that have shapes and types, and no values (of torch's device `meta`): whatever asks for a
value, or mixes them with tensors of the host, would make the host wait. An operation that is no view is one call, a
launch of a kernel or several of a library's; the count is of the portable form, eager.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

#: Operations whose result has a size, or is a number, that only the values tell: the host waits for them.
_WAITS = frozenset(
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
    """Whether an operation makes an accelerator do something: neither a view nor memory alone."""
    return not operation.is_view and operation.name().partition(".")[0] not in _NO_CALLS


class HostWait(Exception):
    """A step asks the accelerator for a value, or brings it one from the host."""


class Launches(NamedTuple):
    """Calls of the accelerator in a step, and what comes out: shapes and types, by the structure of the result."""

    calls: int
    result: Any


def count_launches(module: nn.Module, inputs: Sequence[Any]) -> Launches:
    """Runs a module once on inputs that may be nested; nothing of it is kept.

    Raises:
        HostWait: where the host would have to wait, with the operation.
    """
    counter = _Counter()

    def shape_of(value: Any) -> Any:
        return value.to("meta") if isinstance(value, Tensor) else value

    there = {name: shape_of(value) for name, value in (*module.named_parameters(), *module.named_buffers())}
    given = tree_map(shape_of, tuple(inputs))
    with torch.inference_mode(), counter:
        result = torch.func.functional_call(module, there, given)
    described = tree_map(
        lambda value: (tuple(value.shape), value.dtype) if isinstance(value, Tensor) else value, result
    )
    return Launches(counter.calls, described)


class _Counter(TorchDispatchMode):
    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.calls = 0

    def __torch_dispatch__(
        self, operation: Any, types: Any, arguments: tuple[Any, ...] = (), options: dict[str, Any] | None = None
    ) -> Any:
        name = operation.name()
        given = [value for value in tree_leaves((arguments, options or {})) if isinstance(value, Tensor)]
        there = any(tensor.is_meta for tensor in given)
        # A number that lies on the host goes with the call, not by a copy.
        mixed = there and any(not tensor.is_meta and tensor.ndim for tensor in given)
        by_mask = name.startswith(("aten::index.", "aten::index_put", "aten::_index_put")) and any(
            isinstance(index, Tensor) and index.dtype == torch.bool for index in arguments[1]
        )
        if there and (mixed or by_mask or name in _WAITS):
            raise HostWait(f"{operation}{' by a mask' if by_mask else ' with a tensor of the host' if mixed else ''}")
        result = operation(*arguments, **(options or {}))
        after = [value.is_meta for value in tree_leaves(result) if isinstance(value, Tensor)]
        if name == "aten::detach_" and there:  # all that is seen of torch.tensor([...], device=...)
            raise HostWait("a tensor made of numbers of the host in every call")
        if given and any(after) and not there:
            raise HostWait(f"{operation} brings a constant from the host in every call")
        if any(after) and is_call(operation):
            self.calls += 1
        return result
