"""Tests of the area medians by Triton kernels against the portable form, in Triton's interpreter without a CUDA GPU."""

import math

import pytest
import torch

from fingerflow.ops.fields.area_medians import Apart, area_medians
from fingerflow.ops.fields.strain import STRAIN_MEASURES
from tests.kernels.fused import DEVICE, GPU_TILES, Fused

pytest.importorskip("triton", reason="Triton is not installed: pip install fingerflow-engine[gpu]")
pytestmark = pytest.mark.usefixtures("tiles")

FRAMES, POINTS = 3, 90
GAUGE = 60.0
LONG = pytest.mark.long  # the interpreter takes seconds


def test_no_points(fused: Fused) -> None:
    """Without points no median is known, also where points that entered are kept apart."""
    none = torch.zeros(2, 0, 2, device=DEVICE)
    ellipse = [torch.ones(2, 2, device=DEVICE), torch.ones(2, 2, device=DEVICE), torch.zeros(2, device=DEVICE)]
    apart = Apart(none[..., 0].bool(), none.new_zeros(2, 0, 5), none.new_zeros(2, 0, 5))
    settings = {"gauge_length": GAUGE, "covariance": none.new_zeros(2, 0, 2, 2), "apart": apart}
    expected = area_medians(none, none, *ellipse, **settings)
    fused()
    found = area_medians(none, none, *ellipse, **settings)
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=0, equal_nan=True)
    assert expected.median.isnan().all()
    assert (expected.known == 0).all()


@pytest.mark.parametrize(
    ("measure", "noise", "apart", "tiles"),
    [
        pytest.param("green_lagrange", True, True, "", marks=LONG),
        ("as_printed", True, False, ""),
        pytest.param("infinitesimal", False, True, "", marks=LONG),
        pytest.param("green_lagrange", True, True, GPU_TILES, marks=LONG),
    ],
    indirect=["tiles"],
)
def test_medians(measure: str, noise: bool, apart: bool, fused: Fused) -> None:
    """Medians and their deviations agree in frames with unknown points, and are NaN in a frame without an ellipse."""
    assert measure in STRAIN_MEASURES
    random = torch.Generator().manual_seed(2)
    reference = 300 + 120 * (torch.rand(1, POINTS, 2, generator=random) - 0.5)
    x, y = (reference[0] - 300).unbind(-1)
    displacement = (
        torch.stack((0.04 * x - 2e-4 * x * y, 1e-4 * x * x - 0.06 * y), dim=-1).expand(FRAMES, -1, -1).clone()
    )
    displacement[1] = displacement[1].flip(-1) + 0.3 * torch.randn(POINTS, 2, generator=random)
    displacement[0, 7] = torch.nan
    root = 0.1 * torch.randn(FRAMES, POINTS, 2, 2, generator=random)
    covariance = root @ root.mT
    covariance[0, 3, 0, 0] = torch.nan
    covariance[1, 4, 1, 1] = -1.0
    ellipse = (
        torch.tensor([[300.0, 301.0], [305.0, 295.0], [300.0, 300.0]]),
        torch.tensor([[40.0, 30.0], [30.0, 35.0], [0.0, 10.0]]),
        torch.tensor([0.3, -0.8, 0.0]),
    )
    among = torch.rand(FRAMES, POINTS, generator=random) < 0.15
    fields = 0.05 * torch.randn(FRAMES, POINTS, 5, generator=random)
    fields[0, among[0].nonzero()[0]] = torch.nan
    std = 0.01 + 0.01 * torch.rand(FRAMES, POINTS, 5, generator=random)
    given = reference.to(DEVICE), displacement.to(DEVICE), *(one.to(DEVICE) for one in ellipse)
    entered = Apart(among.to(DEVICE), fields.to(DEVICE), std.to(DEVICE) if noise else None)
    settings = {
        "gauge_length": GAUGE,
        "measure": measure,
        "covariance": covariance.to(DEVICE) if noise else None,
        "apart": entered if apart else None,
    }
    expected = area_medians(*given, **settings)
    fused()
    found = area_medians(*given, **settings)
    assert expected.median[:2].isfinite().all()
    assert expected.median[2].isnan().all()
    # A position whose fit is on a limit may count in one form only, and moves a median by a neighbouring value.
    torch.testing.assert_close(found.known, expected.known, rtol=0, atol=1.5 / 800, equal_nan=True)
    torch.testing.assert_close(found.median, expected.median, rtol=1e-4, atol=2e-6, equal_nan=True)
    assert (found.std is None) == (not noise)
    if expected.std is not None:
        assert (expected.std[:2] > 1e-4).all()
        torch.testing.assert_close(found.std, expected.std, rtol=1e-3, atol=1e-7, equal_nan=True)
    assert not math.isnan(float(found.known[0]))
