"""Tests of `real_contact_mask` against SciPy's median of the intensity loss, with hard frames."""

import numpy as np
import pytest
import scipy.ndimage
import torch
from torch import Tensor

from fingerflow.ops.contact.real_contact_mask import real_contact_mask
from fingerflow.ops.filters.illumination import glass_light

pytestmark = pytest.mark.usefixtures("each_form")


def scene(shape: tuple[int, int, int], dtype: torch.dtype, bits: int = 8) -> tuple[Tensor, Tensor, Tensor]:
    """Return frames (B, 1, H, W) that keep 20 to 110 % of the light, the light (1, 1, H, W) of an uneven empty glass,
    and the dark image (1, 1, H, W), in counts.
    """
    generator = torch.Generator().manual_seed(shape[2])
    batch, height, width = shape
    scale = 2.0 ** (bits - 8)
    black = scale * (5 + torch.rand(1, 1, height, width, generator=generator))
    light = scale * (150 * torch.rand(1, 1, height, width, generator=generator).sqrt() + 20)
    light[..., : height // 8, :] = 0
    share = 0.2 + 0.9 * torch.rand(batch, 1, height, width, generator=generator)
    frames = (black + light * share).clamp(max=2**bits - 1)
    return frames if dtype.is_floating_point else frames.round().to(torch.int32).to(dtype), light, black


@pytest.mark.parametrize("size", [1, 3, 17])
@pytest.mark.parametrize(("dtype", "bits"), [(torch.uint8, 8), (torch.uint16, 16), (torch.float64, 10)])
@pytest.mark.parametrize("shape", [(2, 61, 47), (3, 9, 70)])
def test_the_mask_is_the_median_of_the_intensity_loss_above_0(
    size: int, dtype: torch.dtype, bits: int, shape: tuple[int, int, int]
) -> None:
    frames, light, black = scene(shape, dtype, bits)
    limit = torch.linspace(0.65, 0.68, len(frames))  # near the median share of the light
    found = real_contact_mask(frames, light, black, limit, size)
    lit = (light > 0).numpy()[0, 0]
    for k, frame in enumerate(frames.to(torch.float32 if dtype != torch.float64 else dtype).numpy()[:, 0]):
        # Pixels that are not lit lose no light.
        lost = np.where(lit, (limit[k] * light + black).numpy()[0, 0] - frame, -1.0)
        median = scipy.ndimage.median_filter(lost, size, mode="nearest")
        assert np.array_equal(found[k, 0].numpy(), (median > 0) & lit)
    assert found.any()
    assert not found[..., shape[1] // 8 :, :].all()


def test_the_light_of_the_empty_glass() -> None:
    empty = torch.full((1, 1, 64, 80), 210.0)
    empty[..., :8], empty[..., 20, 20] = 12.0, torch.nan
    dark = torch.full((1, 1, 64, 80), 10.0)
    light, black = glass_light(empty, dark)
    assert (light[..., :8] == 0).all()
    assert light[..., 20, 20] == 0
    assert (light[..., 8:] == 200).sum() == 64 * 72 - 1
    assert torch.equal(black, dark)
    assert torch.equal(glass_light(empty.to(torch.uint8))[1], 0 * dark)
    assert (glass_light(0 * dark)[0] == 0).all()
