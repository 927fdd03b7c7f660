"""Portable form of the ops: a torch mode that selects it, and graphs that run in it like a session."""

from collections.abc import Mapping
from typing import Any

import torch
from onnxruntime import OrtValue
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from fingerflow.engines.torch import TorchSession
from fingerflow.graphs.engine_graphs import Graph


class Portable(TorchDispatchMode):
    """Torch dispatch mode that changes no operation; under it, as under any dispatch mode, ops of the package use their
    portable implementation in place of compiled kernels.
    """

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]

    def __torch_dispatch__(self, operation: Any, types: Any, arguments: Any = (), named: Any = None) -> Any:
        return operation(*arguments, **(named or {}))


class PortableSession(TorchSession):
    """Graph that torch runs in its portable form, which ONNX can express.

    Attributes:
        inputs: tensors of the latest call, by name.
    """

    def __init__(self, graph: Graph) -> None:
        super().__init__(graph, torch.device("cpu"))
        self.inputs: dict[str, Tensor] = {}

    def kept(self, name: str, array: Any) -> Any:
        # An exported graph of the same engine keeps what it shares with this one in memory of ONNX Runtime.
        return super().kept(name, array.numpy() if isinstance(array, OrtValue) else array)

    def __call__(self, inputs: Mapping[str, Any]) -> dict[str, Any]:
        self.inputs = {name: self.kept(name, inputs[name]) for name in self.graph.inputs}
        with torch.inference_mode(), Portable():
            return super().__call__(self.inputs)
