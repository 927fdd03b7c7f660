"""Where the portable form of every op computes, which is what is exported."""

from typing import Any

from torch.utils._python_dispatch import TorchDispatchMode


class Portable(TorchDispatchMode):
    """Compiled kernels do not serve while somebody looks at what the ops do; this one only looks."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]

    def __torch_dispatch__(self, operation: Any, types: Any, arguments: Any = (), named: Any = None) -> Any:
        return operation(*arguments, **(named or {}))
