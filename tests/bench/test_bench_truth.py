"""Tests of the truth of the suites: the noise of pictures, and bounds."""

import pytest
import torch

from bench import skin


@pytest.mark.parametrize("noise", [0, 2])
def test_photograph_has_the_noise_that_the_bound_counts(noise: int) -> None:
    """The noise is sigma^2 = noise^2 + 1/12 to 3 % with 82,000 pixels (0.5 % expected; rounding is not quite white)."""
    clean = skin.clean_picture(skin.QUICK_SHAPE, (0.0, 0.0))
    error = skin.photograph(clean, noise, seed=1).double() - clean
    assert error.square().mean() == pytest.approx(noise**2 + 1 / 12, rel=0.03)
    assert not torch.equal(skin.photograph(clean, 2, seed=1), skin.photograph(clean, 2, seed=2))


def test_bound_is_that_of_central_differences() -> None:
    """The bound is that of central differences over 0.002 px, which are exact to 1e-5 on a texture of periods above 4
    px.
    """
    points = torch.tensor([[[60.0, 50.0], [70.25, 40.5]]])
    step = 1e-3
    y, x = torch.meshgrid(
        torch.arange(-7.0, 8, dtype=torch.float64), torch.arange(-7.0, 8, dtype=torch.float64), indexing="ij"
    )
    for point, bound in zip(points[0].double(), skin.error_bound(points, 3.0, 15), strict=True):
        px, py = x + point[0], y + point[1]
        gx = (skin.grey(px + step, py) - skin.grey(px - step, py)) / (2 * step)
        gy = (skin.grey(px, py + step) - skin.grey(px, py - step)) / (2 * step)
        tensor = torch.stack([(gx * gx).sum(), (gx * gy).sum(), (gx * gy).sum(), (gy * gy).sum()]).view(2, 2)
        torch.testing.assert_close(
            bound @ tensor, 2 * (9 + 1 / 12) * torch.eye(2, dtype=torch.float64), atol=1e-3, rtol=0
        )
