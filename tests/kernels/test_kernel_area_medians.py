"""The compiled medians over an area beside the portable ones: the same operations in double.

Only the mean with which a search begins is a sum in another order; where it ends does not depend on it, to rounding.
"""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from fingerflow import kernels
from fingerflow.ops.area_medians import area_medians

Portable = Callable[[Callable[[], object]], Any]


def random(*shape: int, seed: int) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("shape", [(40, 47), (2, 2), (3, 90)])
@pytest.mark.parametrize("unknown", [0.0, 0.05, 0.7, 1.0])
def test_same_medians(
    instruction_set: int,
    portable: Portable,
    torch_threads: Callable[[int], None],
    shape: tuple[int, int],
    unknown: float,
    threads: int,
) -> None:
    """Rough fields and a displacement that folds here and there, NaN at random, ellipses in and beyond the grid."""
    batch, step = 7, 0.3
    fields, displacement = random(batch, 3, *shape, seed=1) - 0.5, 2 * random(batch, 2, *shape, seed=2)
    fields[random(batch, 3, *shape, seed=3) < unknown / 10] = torch.nan
    displacement.masked_fill_(random(batch, 1, *shape, seed=4) < unknown, torch.nan)
    fields[:, 1] = fields[:, 1].round(decimals=1)  # many equal values
    fields[:, 2] = 3.0
    fields[0, 0, 0, 0] = torch.inf
    center = random(batch, 2, seed=5) * step * (torch.tensor(shape).flip(0) - 1) + 1
    axes, angle = 4 * random(batch, 2, seed=6) ** 3, 6 * random(batch, seed=7)
    torch_threads(threads)

    def call() -> Tensor:
        return area_medians(fields, displacement, (0.1, -0.2), step, center, axes, angle, 0.11)

    found = call()
    torch.testing.assert_close(found, portable(call), rtol=1e-9, atol=1e-12, equal_nan=True)
    strided = area_medians(fields.mT.contiguous().mT, displacement, (0.1, -0.2), step, center, axes, angle, 0.11)
    torch.testing.assert_close(strided, found, rtol=0, atol=0, equal_nan=True)


def test_medians_are_exact(instruction_set: int) -> None:
    """Over a still ellipse the median is the middle of the sorted values; values of very different size too."""
    x = torch.arange(201.0)
    ramps = torch.stack([x, x**9, (x - 100).sign() * 1e30, torch.where(x == 7, 1e38, x)])[:, None].expand(4, 2, 201)
    still = torch.zeros(1, 2, 2, 201)
    ellipse = torch.tensor([[100.0, 0.5]]), torch.tensor([[96.0, 0.4]]), torch.zeros(1)
    found = area_medians(ramps[None], still, (0.0, 0.0), 1.0, *ellipse, 1.0)[0]
    torch.testing.assert_close(found[:3], torch.tensor([100.0, 100.0**9, 0.0]).double(), rtol=1e-6, atol=0)
    assert found[3].item() == pytest.approx(100.0, rel=0.01)  # what was small has become large: one position further


def test_refusals() -> None:
    fields, displacement, ellipses = torch.zeros(1, 1, 3, 3), torch.zeros(1, 2, 3, 3), torch.ones(1, 7).double()
    settings: dict[str, Any] = {
        "turn": 0.6,
        "origin": (0.0, 0.0),
        "step": 1.0,
        "newton_steps": 8,
        "settled": 1e-6,
        "least_ratio": 0.1,
        "least_share": 0.9,
    }
    with pytest.raises(ValueError, match="2 x 2 nodes"):
        kernels.area_medians(fields[:, :, :1], displacement[:, :, :1], ellipses, **settings)
    with pytest.raises(ValueError, match="displacement is"):
        kernels.area_medians(fields, displacement.double(), ellipses, **settings)
    with pytest.raises(ValueError, match="positions"):
        kernels.area_medians(fields, displacement, 1e7 * ellipses, **settings)
