"""Tests of whether the compiled kernels serve, and of the package without them."""

import logging
import os
import subprocess
import sys

import pytest
import torch

from fingerflow.kernels import library
from fingerflow.kernels import tensors as kernels

FRAME = torch.zeros(1, 1, 8, 8, dtype=torch.uint8)
needs_kernels = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")


@needs_kernels
def test_autograd_and_other_devices_are_not() -> None:
    weights = torch.zeros(3, requires_grad=True)
    assert not kernels.serve(FRAME, weights)
    with torch.no_grad():
        assert kernels.serve(FRAME, weights)
    assert not kernels.serve(FRAME.to("meta"))


@needs_kernels
def test_transforms_and_tracing_are_not() -> None:
    seen: list[bool] = []

    def look(frame: torch.Tensor) -> torch.Tensor:
        seen.append(kernels.serve(frame))
        return frame + 1

    torch.func.vmap(look)(FRAME)
    torch.jit.trace(look, (FRAME,), check_trace=False)
    torch.export.export(_Module(look), (FRAME,))
    with torch.utils.flop_counter.FlopCounterMode(display=False):
        look(FRAME)
    assert seen
    assert not any(seen)


class _Module(torch.nn.Module):
    def __init__(self, function: object) -> None:
        super().__init__()
        self.function = function

    def forward(self, frame: torch.Tensor) -> torch.Tensor:
        return self.function(frame)  # type: ignore[operator, no-any-return]


def test_an_environment_variable_turns_kernels_off() -> None:
    code = "from fingerflow.kernels import tensors as kernels; import torch; print(kernels.serve(torch.zeros(1)))"
    environment = {**os.environ, "FINGERFLOW_KERNELS": "0"}
    ran = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "False"


def test_absent_kernels_are_reported_once(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(library, "_path", lambda: None)
    monkeypatch.delenv("FINGERFLOW_KERNELS", raising=False)
    for cached in (library._library, library.is_present, library.compiled):
        cached.cache_clear()
    try:
        with caplog.at_level(logging.INFO, "fingerflow.kernels"):
            assert not kernels.serve(FRAME)
            assert not kernels.serve(FRAME)
        assert [record.levelname for record in caplog.records] == ["INFO"]
        with pytest.raises(RuntimeError, match="pip install"):
            kernels.limit_instruction_set(-1)
    finally:
        library._library.cache_clear()
        library.is_present.cache_clear()
