"""Engines with which rules of the tracker are tested."""

from collections.abc import Callable

import pytest
import torch

from fingerflow.engines.engine import Engine, EngineSettings
from fingerflow.engines.native import NativeEngine
from fingerflow.engines.torch import TorchEngine
from fingerflow.kernels import tensors as kernels


@pytest.fixture(params=["native", "torch"])
def make_engine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Callable[[EngineSettings], Engine]:
    """Return a function that makes an engine of given settings: the compiled engine, or torch without compiled
    kernels.
    """
    if request.param == "torch":
        monkeypatch.setattr(kernels, "serve", lambda *tensors: False)
        return lambda settings: TorchEngine(settings, torch.device("cpu"))
    if not kernels.serve():
        pytest.skip("the compiled kernels were not built or are turned off")
    return NativeEngine
