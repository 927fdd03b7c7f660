"""Tests of the local fits by a Triton kernel against the portable form, in Triton's interpreter without a CUDA GPU."""

import pytest
import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.tensors import serving
from fingerflow.ops.fields.local_fit import local_gradients
from fingerflow.ops.fields.point_gradients import point_gradients
from fingerflow.ops.tracking.deformation import correct_points
from fingerflow.ops.tracking.templates import prepare_templates
from tests.kernels.fused import DEVICE, GPU_TILES, Fused

pytest.importorskip("triton", reason="Triton is not installed: pip install fingerflow-engine[gpu]")
pytestmark = pytest.mark.usefixtures("tiles")

FRAMES, POINTS = 2, 70
LONG = pytest.mark.long  # the interpreter takes seconds
GAUGE = 40.0


def cloud(frames: int, count: int, seed: int = 0) -> Tensor:
    """Return positions (B, N, 2) far from the origin, two of them unknown and one without neighbours."""
    random = torch.Generator().manual_seed(seed)
    found = 500 + 100 * torch.rand(frames, count, 2, generator=random)
    found[:, 1, 0] = torch.nan
    found[0, 2, 1] = torch.inf
    found[:, 3] = torch.tensor([900.0, 900.0])  # without neighbours
    return found.to(DEVICE)


def field(points: Tensor, components: int) -> Tensor:
    x, y = (points - 550).unbind(-1)
    parts = [0.02 * (k + 1) * x - 0.03 * y + 1e-4 * x * y * k + 7 for k in range(components)]
    values = torch.stack(parts, dim=-1).expand(FRAMES, -1, -1).clone()
    values[1, 5] = torch.nan
    return values


def noise_of(kind: str, components: int) -> Tensor | None:
    random = torch.Generator().manual_seed(5)
    if kind == "none":
        return None
    if kind == "variance":
        found = 1e-4 * (1 + torch.rand(1, POINTS, generator=random))
        found[0, 8] = -1.0
        return found.to(DEVICE)
    root = 0.01 * torch.randn(FRAMES, POINTS, components, components, generator=random)
    found = root @ root.mT
    found[0, 9] = torch.nan
    return found.to(DEVICE)


@pytest.mark.parametrize(
    ("components", "noise", "shared", "tiles"),
    [
        (2, "covariance", True, ""),
        pytest.param(4, "none", False, "", marks=LONG),
        pytest.param(2, "variance", False, "", marks=LONG),
        pytest.param(1, "covariance", True, "", marks=LONG),
        pytest.param(2, "covariance", False, GPU_TILES, marks=LONG),
    ],
    indirect=["tiles"],
)
def test_fits(components: int, noise: str, shared: bool, fused: Fused) -> None:
    """The kernel and the portable form give the same fits, for points shared by all frames or not, at points, between
    them and at unknown positions.
    """
    points = cloud(1 if shared else FRAMES, POINTS)
    values = field(points, components)
    queries = torch.cat((points[:1, :12], cloud(1, 9, seed=3)), dim=1)
    settings = {"gauge_length": GAUGE, "variance": noise_of(noise, components)}
    expected = local_gradients(points, values, queries, **settings)
    fused()
    found = local_gradients(points, values, queries, **settings)
    assert expected.value.isnan().any()
    assert expected.value.isfinite().sum() > 20
    torch.testing.assert_close(found.point_count, expected.point_count, rtol=0, atol=0)
    for name in ("value", "gradient", "covariance", "centroid_offset"):
        one, other = getattr(found, name), getattr(expected, name)
        # Sums in another order.
        if other is not None:
            scale = float(other.nan_to_num().abs().max())
            torch.testing.assert_close(one, other, rtol=2e-5, atol=2e-5 * scale, equal_nan=True)
    assert (found.covariance is None) == (noise == "none")


def test_gradients_at_points(fused: Fused) -> None:
    """A point whose own displacement or covariance is unknown has no gradient, in either form."""
    points = cloud(1, POINTS)
    given = points, field(points, 2), GAUGE, noise_of("covariance", 2)
    expected = point_gradients(*given)
    fused()
    for one, other in zip(point_gradients(*given), expected, strict=True):
        torch.testing.assert_close(one, other, rtol=5e-4, atol=2e-6, equal_nan=True)
    assert expected[0][1, 5].isnan().all()
    assert expected[0][0, 9].isnan().all()
    assert expected[0][0, 5].isfinite().all()


@LONG
def test_positions_corrected_for_deformation(fused: Fused) -> None:
    """Positions corrected by four local fits, each fitting results of the one before, agree with the portable form."""
    random = torch.Generator().manual_seed(4)
    start = cloud(1, POINTS) - 490
    image = 200 * torch.rand(1, 1, 130, 130, generator=random).to(DEVICE)
    numbers = prepare_templates(image, start, 21).numbers
    points = start + field(start + 490, 2)
    covariance = (1e-3 * torch.eye(2)).expand(FRAMES, POINTS, 2, 2).to(DEVICE)
    warp = torch.eye(2).expand(1, POINTS, 2, 2).to(DEVICE)
    given = start, points, covariance, numbers, warp, 21, GAUGE
    expected = correct_points(*given)
    fused()
    for one, other in zip(correct_points(*given), expected, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=2e-4, equal_nan=True)
    assert (expected.points - points).abs().nan_to_num().max() > 0.01


def test_fused_fits_serve_single_precision_and_windows_that_fit(fused: Fused) -> None:
    fused()
    given = torch.zeros(1, 3, 2)
    assert kernels.fused_serves(given, None)
    assert not kernels.fused_serves(given.double())
    assert not serving.fused_tracking_serves(torch.zeros(1, 3, 3, 59**2))
