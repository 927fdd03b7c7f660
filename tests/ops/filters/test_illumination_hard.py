"""The quotient where there is no light, no number or no finger."""

import pytest
import torch

from fingerflow.ops.filters.illumination import contact_signal, dequantize, normalize_illumination, quantize


def test_reference_of_zeros_masks_everything() -> None:
    frames = torch.randint(0, 256, (2, 1, 8, 8), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    normalized = normalize_illumination(frames, torch.zeros(1, 1, 8, 8, dtype=torch.uint8))
    assert not normalized.valid.any()
    assert (normalized.frames == 1).all()
    assert (contact_signal(normalized) == 0).all()


def test_reference_below_dark_is_masked() -> None:
    reference = torch.full((1, 1, 8, 8), 100.0)
    dark = torch.full((1, 1, 8, 8), 10.0)
    dark[0, 0, 2, 2] = 120
    normalized = normalize_illumination(reference, reference, dark)
    assert not normalized.valid[0, 0, 2, 2]
    assert normalized.valid.sum() == 63


@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -torch.inf])
@pytest.mark.parametrize("where", ["frames", "reference", "dark"])
def test_a_number_that_is_none_masks_its_pixel_and_no_other(bad: float, where: str) -> None:
    images = {
        "frames": torch.full((2, 1, 8, 8), 50.0),
        "reference": torch.full((1, 1, 8, 8), 100.0),
        "dark": torch.zeros(1, 1, 8, 8),
    }
    images[where][0, 0, 3, 4] = bad
    normalized = normalize_illumination(**images)
    assert normalized.frames.isfinite().all()
    assert not normalized.valid[0, 0, 3, 4]
    assert normalized.frames[0, 0, 3, 4] == 1
    assert normalized.valid.sum() == (127 if where == "frames" else 126)


def test_all_and_no_contact() -> None:
    reference = torch.full((1, 1, 8, 8), 200, dtype=torch.uint8)
    normalized = normalize_illumination(torch.cat([reference, torch.zeros_like(reference)]), reference)
    signal = contact_signal(normalized)
    assert (signal[0] == 0).all()
    assert (signal[1] == 1).all()


def test_saturated_frame_is_brighter_than_the_glass_never_contact() -> None:
    reference = torch.full((1, 1, 8, 8), 200, dtype=torch.uint8)
    signal = contact_signal(normalize_illumination(torch.full((1, 1, 8, 8), 255, dtype=torch.uint8), reference))
    assert torch.allclose(signal, torch.tensor(-55 / 200))
    assert (quantize(signal) == 0).all()  # below the lowest level, which it takes


def test_quotient_that_overflows_is_masked() -> None:
    reference = torch.full((1, 1, 4, 4), 1e-30)
    normalized = normalize_illumination(torch.full((1, 1, 4, 4), 1e30), reference)
    assert not normalized.valid.any()


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_is_computed_in_float32(dtype: torch.dtype) -> None:
    reference = torch.full((1, 1, 4, 4), 4000.0, dtype=dtype)
    normalized = normalize_illumination(reference / 4, reference)
    assert normalized.frames.dtype == torch.float32
    assert (normalized.frames == 0.25).all()


def test_empty_batch_and_one_pixel() -> None:
    one = torch.ones(1, 1, 1, 1)
    assert normalize_illumination(torch.zeros(0, 1, 1, 1), one).frames.shape == (0, 1, 1, 1)
    assert normalize_illumination(one, one).valid.all()


def test_levels_of_what_is_no_number() -> None:
    levels = quantize(torch.tensor([torch.nan, torch.inf, -torch.inf, -3.0, 7.0]))
    assert levels.tolist() == [0, 255, 0, 0, 255]
    assert dequantize(torch.tensor([torch.nan])).isnan().all()
