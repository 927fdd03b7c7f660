"""Fields at points and over the contact: the graph in all its forms beside the ops it is made of."""

import pytest
import torch
from torch import Tensor

from fingerflow import kernels
from fingerflow.graphs import FieldsGraph, GrossEllipse
from fingerflow.graphs.frame import SinceOnsetGraph
from fingerflow.ops.local_fit import local_gradients
from fingerflow.ops.strain import curl, divergence, green_lagrange
from fingerflow.ops.strain_uncertainty import curl_std, divergence_std

GAUGE = 70.0


def skin(batch: int = 2) -> tuple[Tensor, Tensor]:
    """Reference positions and displacements (B, 300, 2), px, with points that are missing and one that is alone."""
    generator = torch.Generator().manual_seed(0)
    reference = torch.rand(batch, 300, 2, generator=generator) * torch.tensor([340.0, 280.0]) + 100
    gradient = torch.tensor([[0.05, 0.02], [-0.01, 0.08]])
    displacement = (reference - 250) @ gradient.T + 0.5 * torch.sin(reference / 30) + 17
    reference[0, 5] = torch.nan
    displacement[-1, 7] = torch.nan
    reference[0, 6] = torch.tensor([2000.0, 2000.0])
    return reference, displacement


def ellipse(batch: int = 2) -> GrossEllipse:
    return GrossEllipse(
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
    gradient[1, 7] = torch.nan  # what its neighbours say is no measurement of a point that is lost
    assert fit.gradient[1, 7].isfinite().all()
    # Float32 positions of 500 px are rounded to 3e-5 px, over a gauge length of 70 px.
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


def test_pixels_of_the_topographic_view_or_millimetres(monkeypatch: pytest.MonkeyPatch) -> None:
    """What an exported graph computes in pixels, a recording does in mm: the same numbers."""
    reference, displacement = skin()
    matrix = torch.tensor([[0.999, 0.02, 30.4], [-0.02, 0.999, -10.3]])
    middle, axes, angle = ellipse()
    millimetres = 0.03
    place = (reference @ matrix[:, :2].T + matrix[:, 2]) * millimetres
    moved = displacement @ matrix[:, :2].T * millimetres
    center = middle @ matrix[:, :2].T + matrix[:, 2]
    expected = FieldsGraph(GAUGE * millimetres)(
        place, moved, None, GrossEllipse(center * millimetres, axes * millimetres, angle)
    )
    monkeypatch.setattr(kernels, "serve", lambda *tensors: False)
    touched = torch.ones(reference.shape[:2], dtype=torch.uint8)
    glass = (matrix, torch.tensor([millimetres]))
    none = torch.zeros(*touched.shape, 2, 2)
    found = SinceOnsetGraph(GAUGE * millimetres)(
        reference + displacement, touched, reference, touched, 0 * touched, none, reference, *glass, center, axes, angle
    )[5:]
    assert expected.median is not None
    for ours, theirs in zip(found, (*expected[:3], expected.median[:, 0]), strict=True):
        torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-4, equal_nan=True)


def test_a_touch_that_does_not_stay_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    """Covered in the frames 1 and 2 and from 5 on: what counts in the end is where the point was in frame 5."""
    monkeypatch.setattr(kernels, "serve", lambda *tensors: False)
    graph = SinceOnsetGraph(1.6)
    reference = torch.full((1, 1, 2), torch.nan)
    reached, entry = torch.zeros(2, 1, 1, dtype=torch.uint8)
    entering = torch.full((1, 1, 2, 2), torch.nan), torch.zeros(1, 1, 2)
    glass = (torch.eye(2, 3), torch.ones(1), torch.zeros(1, 2), torch.ones(1, 2), torch.zeros(1))
    starts = []
    for number, covers in enumerate([0, 1, 1, 0, 0, 1, 1, 1, 0, 1]):
        touched = torch.full((1, 1), covers, dtype=torch.uint8)
        found = graph(torch.full((1, 1, 2), float(number)), touched, reference, reached, entry, *entering, *glass)
        reference, reached, entry = found.next_reference, found.next_reached, found.next_entry
        starts.append(float(reference[0, 0, 0]))
    nothing = torch.nan
    torch.testing.assert_close(
        torch.tensor(starts), torch.tensor([nothing, 1, 1, nothing, nothing, 5, 5, 5, 5, 5]), equal_nan=True
    )
