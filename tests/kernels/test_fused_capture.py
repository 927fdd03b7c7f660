"""Tests that the callers of Triton kernels can be captured as a CUDA graph: the host waits for no value, and the memory
that they take depends on sizes, not on data.
"""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from bench.launches import WAITS
from fingerflow.ops.tracking.templates import Templates
from tests.kernels.fused import DEVICE

triton = pytest.importorskip("triton", reason="Triton is not installed: pip install fingerflow-engine[gpu]")
InterpretedFunction = pytest.importorskip("triton.runtime.interpreter").InterpretedFunction

FRAMES, POINTS, HEIGHT, WIDTH = 2, 9, 40, 56


class Allocations(TorchDispatchMode):
    """Record the operations of torch in a block of code, with the sizes of their results."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.seen: list[tuple[str, list[tuple[int, ...]]]] = []

    def __torch_dispatch__(self, operation: Any, types: Any, arguments: Any = (), named: Any = None) -> Any:
        result = operation(*arguments, **(named or {}))
        tensors = [one for one in torch.utils._pytree.tree_leaves(result) if isinstance(one, Tensor)]
        self.seen.append((operation.name(), [tuple(one.shape) for one in tensors]))
        return result


def given(seed: int) -> dict[str, Tensor]:
    """Return random inputs by name; those of the seed 0 are zero or False."""
    random = torch.Generator().manual_seed(seed)

    def some(*shape: int) -> Tensor:
        return (torch.rand(*shape, generator=random) if seed else torch.zeros(shape)).to(DEVICE)

    points = 30 * some(1, POINTS, 2)
    return {
        "mask": some(FRAMES, 1, HEIGHT, WIDTH) > 0.5,
        "frames": (255 * some(FRAMES, 1, HEIGHT, WIDTH)).to(torch.uint8),
        "light": 200 * some(1, 1, HEIGHT, WIDTH),
        "black": some(1, 1, HEIGHT, WIDTH),
        "share": some(FRAMES),
        "points": points,
        "moved": points.expand(FRAMES, -1, -1).contiguous() + some(FRAMES, POINTS, 2),
        "values": some(FRAMES, POINTS, 2),
        "covariance": some(FRAMES, POINTS, 2, 2),
        "ellipses": 20 * some(FRAMES, 6),
        "apart": some(FRAMES, POINTS) > 0.5,
        "fields": some(FRAMES, POINTS, 5),
        "number": torch.arange(POINTS, device=DEVICE).expand(1, 4, POINTS).contiguous(),
        "offset": some(1, 4, POINTS, 2),
        "within": some(1, 4, POINTS),
        "std": some(FRAMES, POINTS),
        "samples": some(1, POINTS, 3, 81),
        "numbers": some(1, POINTS, 32),
    }


def calls() -> dict[str, Callable[[dict[str, Tensor]], Any]]:
    """Return a call of each function that launches kernels of Triton."""
    from fingerflow.kernels.tensors import (
        fused_contact,
        fused_fits,
        fused_medians,
        fused_outliers,
        fused_pixels,
        fused_tracking,
    )

    radius = {"radius": 20.0}
    return {
        "contact": lambda g: fused_contact.apparent_contact(g["mask"], 4, 2),
        "gain": lambda g: fused_pixels.illumination_gain(g["frames"], g["light"], g["black"], 16),
        "mask": lambda g: fused_pixels.real_contact_mask(g["frames"], g["light"], g["black"], g["share"], 3),
        "fits": lambda g: fused_fits.local_gradients(
            g["points"], g["values"], g["points"], g["covariance"], least_spread=0.1, minimum_points=4, **radius
        ),
        "medians": lambda g: fused_medians.area_medians(
            *(g[one] for one in ("points", "values", "ellipses", "covariance", "apart", "fields", "fields")),
            measure=0,
            **radius,
        ),
        "outliers": lambda g: fused_outliers.find_outliers(
            *(g[one] for one in ("number", "offset", "within", "values", "std"))
        ),
        "tracking": lambda g: fused_tracking.find_templates(
            Templates(g["points"], g["samples"], g["numbers"]),
            *(g["frames"], g["points"], None, None, 2, 1 / 12, 1.0, 0.3),
        ),
    }


NAMES = ("contact", "gain", "mask", "fits", "medians", "outliers", "tracking")


@pytest.mark.parametrize("name", NAMES)
def test_it_can_be_captured(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two frames of other content take the same operations with results of the same sizes, and none of them waits."""
    # Launches are left out: the interpreter of Triton itself copies tensors by torch.
    for kind in (triton.runtime.JITFunction, InterpretedFunction):
        monkeypatch.setattr(kind, "__getitem__", lambda *_: lambda *_, **__: None)
    call, seen = calls()[name], []
    call(given(0))  # constants are copied to the device in the first call
    for seed in (0, 1):
        inputs = given(seed)
        with Allocations() as allocations:
            call(inputs)
        seen.append(allocations.seen)
    assert seen[0] == seen[1]
    assert seen[0]
    waiting = {operation for operation, _ in seen[0]} & WAITS
    assert not waiting
