"""Tests of fields at points and over the contact: the graph in all its forms against the ops that it uses."""

import pytest
import torch
from torch import Tensor

from fingerflow.graphs import FieldsGraph, FrameEllipse
from fingerflow.ops.fields.local_fit import local_gradients
from fingerflow.ops.fields.point_gradients import query_gradients
from fingerflow.ops.fields.strain import curl, divergence, green_lagrange
from fingerflow.ops.fields.strain_uncertainty import curl_std, divergence_std

GAUGE = 70.0


def skin(batch: int = 2) -> tuple[Tensor, Tensor]:
    """Return reference positions and displacements (B, 300, 2), px, with missing points and one point far from all
    others.
    """
    generator = torch.Generator().manual_seed(0)
    reference = torch.rand(batch, 300, 2, generator=generator) * torch.tensor([340.0, 280.0]) + 100
    gradient = torch.tensor([[0.05, 0.02], [-0.01, 0.08]])
    displacement = (reference - 250) @ gradient.T + 0.5 * torch.sin(reference / 30) + 17
    reference[0, 5] = torch.nan
    displacement[-1, 7] = torch.nan
    reference[0, 6] = torch.tensor([2000.0, 2000.0])
    return reference, displacement


def ellipse(batch: int = 2) -> FrameEllipse:
    return FrameEllipse(
        torch.tensor([[287.0, 257.0]]).repeat(batch, 1),
        torch.tensor([[150.0, 110.0]]).repeat(batch, 1),
        torch.zeros(batch),
    )


@pytest.mark.usefixtures("each_form")
def test_fields_at_points_are_those_of_local_gradients() -> None:
    reference, displacement = skin()
    covariance = torch.tensor([[0.02, 0.004], [0.004, 0.01]]).expand(2, 300, 2, 2)
    fields = FieldsGraph(GAUGE)(reference, displacement, covariance)
    fit = local_gradients(reference.double(), displacement.double(), gauge_length=GAUGE, variance=covariance.double())
    assert fit.covariance is not None
    assert fields.divergence_std is not None
    assert fields.curl_std is not None
    gradient = fit.gradient.clone()
    gradient[1, 7] = torch.nan  # a lost point has no gradient, although its neighbours give one
    assert fit.gradient[1, 7].isfinite().all()
    # Float32 positions of 500 px are rounded to 3e-5 px; the gauge length is 70 px.
    for ours, expected in (
        (fields.divergence, divergence(gradient)),
        (fields.curl, curl(gradient)),
        (fields.strain, green_lagrange(gradient)),
        (fields.divergence_std, divergence_std(fit.covariance) + 0 * gradient[..., 0, 0]),
        (fields.curl_std, curl_std(fit.covariance) + 0 * gradient[..., 0, 0]),
    ):
        torch.testing.assert_close(ours.double(), expected, rtol=0, atol=5e-5, equal_nan=True)
    assert fields.median is None


@pytest.mark.usefixtures("each_form")
def test_one_set_of_points_serves_all_frames() -> None:
    reference, displacement = skin(1)
    moved = torch.cat((displacement, 0.8 * displacement, displacement + torch.nan))
    covariance = 1e-3 * torch.eye(2).expand(3, 300, 2, 2)
    together = FieldsGraph(GAUGE)(reference, moved, covariance, ellipse(3))
    for frame in range(3):
        part = slice(frame, frame + 1)
        alone = FieldsGraph(GAUGE)(reference, moved[part], covariance[part], ellipse(1))
        for name, values in together._asdict().items():
            torch.testing.assert_close(values[part], getattr(alone, name), rtol=1e-4, atol=2e-5, equal_nan=True)
    assert together.median is not None
    assert together.median[:2].isfinite().all()
    assert together.median[2].isnan().all()


def test_the_exported_fit_is_that_of_local_gradients() -> None:
    """The exported fit and its covariance agree with `local_gradients` in float32 and float64, also at positions
    between the points and at NaN.
    """
    reference, displacement = skin()
    queries = torch.cat((reference[:, :40] + 3, reference[:, 5:8]), dim=1)
    noise = torch.linspace(1, 2, reference.shape[1])[None].expand(displacement.shape[:2]).double()
    wide = reference.double(), displacement.double(), queries.double()
    expected = local_gradients(*wide, gauge_length=GAUGE, variance=noise)
    assert expected.covariance is not None
    for kind, rounding in ((torch.float32, 5e-5), (torch.float64, 1e-9)):
        inputs = (values.to(kind) for values in (reference, displacement, queries))
        gradient, covariance = query_gradients(*inputs, torch.tensor([GAUGE]), noise.to(kind))
        assert gradient.dtype == kind
        torch.testing.assert_close(gradient.double(), expected.gradient, rtol=0, atol=rounding, equal_nan=True)
        torch.testing.assert_close(
            covariance.double(), expected.covariance, rtol=10 * rounding, atol=rounding, equal_nan=True
        )
    assert expected.gradient.isnan().any()
