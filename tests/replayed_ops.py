"""Recorded calls on the processor in place of CUDA graphs: ops are replayed into the tensors of the recording."""

from collections.abc import Callable
from typing import Any

from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from fingerflow.engines.capture import RecordedCall


class Ops(TorchDispatchMode):
    """Records every op with its arguments and results."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.made: list[tuple[Any, tuple[Any, ...], dict[str, Any], Any]] = []

    def __torch_dispatch__(
        self, operation: Any, types: Any, arguments: tuple[Any, ...] = (), options: dict[str, Any] | None = None
    ) -> Any:
        result = operation(*arguments, **(options or {}))
        self.made.append((operation, arguments, options or {}, result))
        return result


def record(call: Callable[[], Any]) -> RecordedCall:
    call()
    with Ops() as ops:
        result = call()

    def replay() -> None:
        for operation, arguments, options, first in ops.made:
            given = {one.untyped_storage().data_ptr() for one in tensors((arguments, options))}
            again = operation(*arguments, **options)
            for old, new in zip(tensors(first), tensors(again), strict=True):
                if old.untyped_storage().data_ptr() not in given:  # otherwise a view, or changed in place
                    old.copy_(new)

    return RecordedCall(replay, result)


def tensors(value: Any) -> list[Tensor]:
    return [one for one in tree_leaves(value) if isinstance(one, Tensor)]
