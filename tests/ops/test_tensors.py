"""Tests of elementary tensor operations whose exported form differs from the one that torch computes."""

import math

import pytest
import torch

from fingerflow.ops.tensors import half_angle


@pytest.mark.parametrize(("kind", "tolerance"), [(torch.float32, 1e-6), (torch.float64, 2e-8)])
@pytest.mark.parametrize("length", [1e-6, 1.0, 1e6])
def test_half_angle(kind: torch.dtype, tolerance: float, length: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The exported form gives half the angle of vectors of all directions, and 0 for a vector of no length."""
    angle = torch.linspace(-math.pi, math.pi, 10001, dtype=torch.float64)
    x, y = (length * angle.cos()).to(kind), (length * angle.sin()).to(kind)
    expected = torch.atan2(y.double(), x.double()) / 2
    torch.testing.assert_close(half_angle(y, x).double(), expected, rtol=0, atol=tolerance)
    monkeypatch.setattr(torch.compiler, "is_exporting", lambda: True)
    torch.testing.assert_close(half_angle(y, x).double(), expected, rtol=0, atol=tolerance)
    none = torch.zeros(1, dtype=kind)
    assert half_angle(none, none) == 0
