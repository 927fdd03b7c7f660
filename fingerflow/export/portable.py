"""Torch mode that selects the portable implementation of every op, which can be exported to ONNX."""

from typing import Any

from torch.utils._python_dispatch import TorchDispatchMode


class Portable(TorchDispatchMode):
    """Torch dispatch mode that changes no operation; under it, as under any dispatch mode, ops of the package use their
    portable implementation in place of compiled kernels.
    """

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]

    def __torch_dispatch__(self, operation: Any, types: Any, arguments: Any = (), named: Any = None) -> Any:
        return operation(*arguments, **(named or {}))
