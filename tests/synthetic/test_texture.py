import math

import pytest
import torch
from torch import Tensor

from fingerflow.synthetic import RidgeTexture, texture_image

MM_PER_PX = 0.0325
SHAPE = (256, 320)


def field_of_view(count: int) -> Tensor:
    generator = torch.Generator().manual_seed(7)
    return torch.rand(count, 2, generator=generator, dtype=torch.float64) * torch.tensor([20.8, 16.6]).double()


@pytest.mark.parametrize("seed", [0, 1])
def test_spectrum_ends_below_half_of_the_nyquist_limit(seed: int) -> None:
    image = texture_image(RidgeTexture(centre=(5.0, 4.0), seed=seed), SHAPE, MM_PER_PX)[0, 0]
    # Blackman's side lobes are below 1e-6 of the power, so power above the limit is that of the texture.
    rows, columns = (torch.blackman_window(n, dtype=torch.float64) for n in SHAPE)
    power = torch.fft.rfft2(image * rows[:, None] * columns).abs().square()
    frequency = torch.hypot(
        torch.fft.fftfreq(SHAPE[0], dtype=torch.float64)[:, None], torch.fft.rfftfreq(SHAPE[1], dtype=torch.float64)
    )
    assert power[frequency > 0.26].sum() < 1e-8 * power.sum()


@pytest.mark.parametrize("share", [0.15, 0.5])
def test_margin_of_a_ridge_is_the_distance_from_its_edge(share: float) -> None:
    """The margin is the distance from the edge of the touching part all over ridge and valley: half of its width on the
    crest, also where that is only 2 px. A margin that levels off there would draw a thin ridge paler than a lens does.
    """
    texture, points = RidgeTexture(centre=(5.0, 4.0)), field_of_view(20000)
    x, y = points.unbind(1)
    margin = texture.ridge_margin(x, y, share, torch.full_like(x, 9.0))
    height = torch.cos(texture.ridge_phase(x, y))
    assert torch.equal(margin > 0, height > math.cos(math.pi * share))
    # The arc cosine of a height is the phase from the crest.
    expected = (math.pi * share - torch.acos(height.clamp(-1, 1))) * (texture.period / (2 * math.pi))
    torch.testing.assert_close(margin, expected, rtol=0, atol=1e-7)
    assert float(margin.max()) == pytest.approx(share * texture.period / 2, rel=0.01)
    assert float(margin.min()) == pytest.approx((share - 1) * texture.period / 2, rel=0.01)
