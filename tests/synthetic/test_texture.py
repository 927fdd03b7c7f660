import math

import pytest
import torch

from fingerflow.synthetic import RidgeTexture


@pytest.mark.parametrize("share", [0.15, 0.5])
def test_margin_of_a_ridge_is_the_distance_from_its_edge(share: float) -> None:
    """The margin is the distance from the edge of the touching part all over ridge and valley: half of its width on the
    crest, also where that is only 2 px. A margin that levels off there would draw a thin ridge paler than a lens does.
    """
    texture, draw = RidgeTexture(centre=(5.0, 4.0)), torch.Generator().manual_seed(7)
    x, y = torch.rand(2, 20000, generator=draw, dtype=torch.float64) * torch.tensor([[20.8], [16.6]])
    margin = texture.ridge_margin(x, y, share, torch.full_like(x, 9.0))
    height = torch.cos(texture.ridge_phase(x, y))
    assert torch.equal(margin > 0, height > math.cos(math.pi * share))
    # The arc cosine of a height is the phase from the crest.
    expected = (math.pi * share - torch.acos(height.clamp(-1, 1))) * (texture.period / (2 * math.pi))
    torch.testing.assert_close(margin, expected, rtol=0, atol=1e-7)
    assert float(margin.max()) == pytest.approx(share * texture.period / 2, rel=0.01)
    assert float(margin.min()) == pytest.approx((share - 1) * texture.period / 2, rel=0.01)
