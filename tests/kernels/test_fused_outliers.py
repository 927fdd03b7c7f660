"""Tests of outlier flags by Triton kernels against the portable form, in Triton's interpreter without a CUDA GPU."""

import pytest
import torch

from fingerflow.ops.tracking.outliers import find_neighbours, find_outliers
from tests.kernels.fused import DEVICE, GPU_TILES, Fused

pytest.importorskip("triton", reason="Triton is not installed: pip install fingerflow-engine[gpu]")
pytestmark = pytest.mark.usefixtures("tiles")


@pytest.mark.filterwarnings("ignore:overflow")  # of NumPy in the interpreter: a plane through one neighbour
@pytest.mark.parametrize(
    ("frames", "points", "shared", "tiles"),
    [
        (3, 150, True, ""),
        (2, 90, False, ""),
        (1, 6, True, ""),
        pytest.param(2, 150, False, GPU_TILES, marks=pytest.mark.long),
    ],
    indirect=["tiles"],
)
def test_outliers(frames: int, points: int, shared: bool, fused: Fused) -> None:
    """The kernels flag the same points as the portable form, among wrong, uncertain, unknown and solitary points."""
    random = torch.Generator().manual_seed(points)
    start = 100 * torch.rand(1 if shared else frames, points, 2, generator=random)
    start[:, 4] = torch.tensor([900.0, 900.0])
    displacement = 0.02 * start.flip(-1).expand(frames, -1, -1) + 0.05 * torch.randn(
        frames, points, 2, generator=random
    )
    wrong, uncertain = (torch.rand(frames, points, generator=random) < 0.05 for _ in range(2))
    displacement = displacement + 2.0 * wrong[..., None]
    std = torch.where(uncertain, 0.5, 0.05)
    displacement[0, 1] = torch.nan
    std[0, 2] = torch.nan
    near = find_neighbours(start, 60.0)
    given = type(near)(*(one.to(DEVICE) for one in near)), displacement.to(DEVICE), std.to(DEVICE)
    expected = find_outliers(*given)
    fused()
    found = find_outliers(*given)
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=0)
    if points > 50:
        assert expected.off_neighbours.sum() > 3
        assert expected.uncertain.sum() > 3
