"""Tests of figure S6: parts that add up, each with its known amount."""

import io

import numpy as np
import pytest
from matplotlib.figure import Figure

from fingerflow.report.decomposition import PARTS, decompose, draw_decomposition

POINTS = np.random.default_rng(0).uniform((5, 3), (15, 12), (300, 2))
GRADIENT = np.array([[0.03, -0.012], [0.02, 0.01]])


def test_a_linear_field_is_found_exactly() -> None:
    moved = (POINTS - POINTS.mean(0)) @ GRADIENT.T + (0.1, -0.05)
    found = decompose(POINTS, moved)
    assert found.constant == pytest.approx((0.1, -0.05))
    assert (found.divergence, found.curl, *found.shear) == pytest.approx((0.04, 0.032, 0.02, 0.008))
    np.testing.assert_allclose(sum(found.parts[name] for name in PARTS[1:]), moved, atol=1e-14)
    np.testing.assert_allclose(found.parts["rest"], 0, atol=1e-14)


def test_points_that_are_not_known_change_nothing() -> None:
    moved = (POINTS - POINTS[5:].mean(0)) @ GRADIENT.T
    moved[:5] = np.nan
    found = decompose(POINTS, moved)
    assert found.divergence == pytest.approx(0.04)
    assert np.isnan(found.parts["rest"][:5]).all()
    assert np.isfinite(found.parts["curl"]).all()


def test_the_figure_draws_all_parts_in_one_scale() -> None:
    moved = (POINTS - POINTS.mean(0)) @ GRADIENT.T + (0.1, -0.05)
    found = decompose(POINTS, moved)
    figure = Figure(layout="constrained")
    axes = draw_decomposition(figure.add_subfigure(figure.add_gridspec(1, 1)[0]), found)
    figure.savefig(io.BytesIO(), dpi=40)
    assert [one.get_title().partition("\n")[0] for one in axes] == list(PARTS)
    assert "40.0 µm/mm" in axes[2].get_title()
    assert "32.0 µm/mm" in axes[3].get_title()
    arrows = [np.stack((one.collections[0].U, one.collections[0].V), 1) for one in axes]
    np.testing.assert_allclose(sum(arrows[1:]), arrows[0], atol=1e-9)
    scale = float(axes[0].get_title().split()[-2])
    np.testing.assert_allclose(arrows[0], scale * moved)
    assert all(one.yaxis_inverted() for one in axes)


@pytest.mark.parametrize("points", [np.zeros((2, 2)), np.column_stack((np.arange(9.0), np.arange(9.0)))])
def test_points_without_area_are_refused(points: np.ndarray) -> None:
    with pytest.raises(ValueError, match="span no area"):
        decompose(points, 0 * points)
    with pytest.raises(ValueError, match="of the same points"):
        decompose(points, np.zeros((4, 2)))
