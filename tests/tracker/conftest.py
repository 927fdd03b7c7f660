"""The engine with which rules of the tracker are tested."""

from collections.abc import Callable

import pytest
import torch

from fingerflow.engines.engine import Engine, EngineSettings
from fingerflow.engines.native import NativeEngine
from fingerflow.engines.torch import TorchEngine
from fingerflow.kernels import tensors as kernels


@pytest.fixture
def make_engine() -> Callable[[EngineSettings], Engine]:
    """Return a function that makes an engine of given settings: the compiled one where it was built."""
    if kernels.serve():
        return NativeEngine
    return lambda settings: TorchEngine(settings, torch.device("cpu"))
