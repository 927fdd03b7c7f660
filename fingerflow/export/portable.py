"""Portable form of the ops: a torch mode that selects it, and graphs that run in it like a session."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

if TYPE_CHECKING:
    from fingerflow.export.build import Graph


class Portable(TorchDispatchMode):
    """Torch dispatch mode that changes no operation; under it, as under any dispatch mode, ops of the package use their
    portable implementation in place of compiled kernels.
    """

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]

    def __torch_dispatch__(self, operation: Any, types: Any, arguments: Any = (), named: Any = None) -> Any:
        return operation(*arguments, **(named or {}))


class PortableSession:
    """Graph that torch runs, with the interface of `engines.sessions.GraphSession`.

    Attributes:
        inputs: tensors of the latest call, by name.
    """

    shares_memory = True

    def __init__(self, graph: "Graph") -> None:
        self.graph = graph
        self.inputs: dict[str, Tensor] = {}

    def kept(self, name: str, array: NDArray[Any]) -> NDArray[Any]:
        return array

    def __call__(self, inputs: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
        self.inputs = {name: torch.from_numpy(np.ascontiguousarray(inputs[name])) for name in self.graph.inputs}
        return {name: tensor.numpy() for name, tensor in self.graph.run(self.inputs).items()}
