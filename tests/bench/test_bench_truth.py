"""Tests of the truth of the suites: pictures, motion and bounds."""

import math

import pytest
import torch

from bench import skin
from bench.errors_of_tracks import error_cells


def test_moved_picture_shows_the_skin_at_the_place_it_came_from() -> None:
    """A picture moved by whole pixels has the same pixels elsewhere, to the rounding of float64."""
    still, moved = (skin.clean_picture((60, 80), shift) for shift in ((0.0, 0.0), (3.0, -2.0)))
    torch.testing.assert_close(moved[..., :-2, 3:], still[..., 2:, :-3], atol=1e-9, rtol=0)


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


def test_error_cells_of_known_errors() -> None:
    """The cells are those of two accepted errors, (1, 0) and (3, 0), and of a third point that is not accepted."""
    errors = torch.tensor([[1.0, 0.0], [3.0, 0.0], [100.0, 100.0]])
    bound = torch.diag_embed(torch.tensor([[4.0, 1.0], [4.0, 1.0], [9.0, 9.0]], dtype=torch.float64))
    cells = error_cells(errors, torch.tensor([True, True, False]), bound)
    assert cells["rms_px"] == pytest.approx(math.sqrt(10 / 4))
    assert cells["over_bound"] == pytest.approx(1.0)
    assert cells["bias_px"] == 2
    assert cells["bias_se_px"] == pytest.approx(1.0)
    assert cells["accepted"] == pytest.approx(2 / 3)
    assert error_cells(errors, torch.zeros(3, dtype=torch.bool))["rms_px"] is None
