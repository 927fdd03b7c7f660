"""Tests of the quotient of a frame and the empty glass, and of the byte that encodes the contact signal."""

import pytest
import torch

from fingerflow.ops.filters.illumination import contact_signal, normalize_illumination


def lamp(height: int = 40, width: int = 50) -> torch.Tensor:
    """Return uneven light (1, 1, H, W), float64, from 60 to 200 counts."""
    y, x = torch.meshgrid(torch.linspace(-1, 1, height), torch.linspace(-1, 1, width), indexing="ij")
    return (200 - 70 * (x.square() + y.square()))[None, None].double()


@pytest.mark.parametrize(
    ("dtype", "full", "tolerance"),
    # Half a count of rounding in frame and reference, relative to the darkest pixels, 60 / 200 of full light.
    [(torch.uint8, 200, 0.02), (torch.int16, 4000, 1e-3), (torch.uint16, 60000, 7e-5), (torch.float32, 1.0, 1e-6)],
)
def test_uneven_light_cancels(dtype: torch.dtype, full: float, tolerance: float) -> None:
    transmission = torch.rand(3, 1, 40, 50, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    light = lamp() / 200 * full
    dark = torch.full_like(light, full / 20)

    def recorded(counts: torch.Tensor) -> torch.Tensor:
        return counts.to(dtype) if dtype.is_floating_point else counts.round().to(dtype)

    frames, reference, black = recorded(transmission * light + dark), recorded(light + dark), recorded(dark)
    normalized = normalize_illumination(frames, reference, black)
    assert normalized.frames.dtype == torch.float32
    assert normalized.valid.all()
    assert (normalized.frames - transmission).abs().max() < tolerance
    assert (contact_signal(normalized) - (1 - transmission)).abs().max() < tolerance


def test_dark_corners_are_masked_at_the_stated_fraction() -> None:
    reference = torch.full((1, 1, 100, 100), 200.0)
    reference[..., 0, :4] = torch.tensor([0.0, 9.9, 10.0, 10.1])
    frames = torch.full((2, 1, 100, 100), 50.0)
    normalized = normalize_illumination(frames, reference)
    assert normalized.valid[0, 0, 0, :4].tolist() == [False, False, False, True]
    assert (normalized.frames[:, 0, 0, :3] == 1).all()
    assert normalized.valid[..., 1:, :].all()
    assert normalize_illumination(frames, reference, minimum_illumination=0).valid[0, 0, 0, :2].tolist() == [0, 1]
