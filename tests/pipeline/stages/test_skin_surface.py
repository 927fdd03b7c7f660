"""Tests of the interpolation of displacements: exact for a plane, else SciPy's thin plate; lost points have no
influence.
"""

import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator

from fingerflow.pipeline.stages.slip.slip_grid import SkinSurface

DRAW = np.random.default_rng(0)
POINTS, PLACES = 12 * DRAW.random((120, 2)), 1 + 10 * DRAW.random((300, 2))


def bent(places: np.ndarray) -> np.ndarray:
    return np.stack((np.sin(places[:, 0] / 3), np.cos(places[:, 1] / 2)), 1)


def test_a_linear_field_is_exact_whoever_is_lost() -> None:
    slope = np.array([[0.1, -0.2], [0.05, 0.3]])
    moved = POINTS @ slope + 0.5
    moved[7, 0], moved[9] = np.nan, np.nan
    # Rounding of values up to 6 in float32.
    np.testing.assert_allclose(SkinSurface(POINTS, PLACES)(moved), PLACES @ slope + 0.5, atol=1e-5)


@pytest.mark.parametrize("lost", [0, 40])
def test_the_surface_is_the_thin_plate_spline_of_the_known_points(lost: int) -> None:
    moved = bent(POINTS)
    moved[np.random.default_rng(1).permutation(len(POINTS))[:lost]] = np.nan
    there = np.isfinite(moved).all(1)
    expected = RBFInterpolator(POINTS[there], moved[there], kernel="thin_plate_spline")(PLACES)
    np.testing.assert_allclose(SkinSurface(POINTS, PLACES)(moved), expected, atol=1e-5)


def test_displacement_is_not_made_up() -> None:
    moved = np.full_like(POINTS, np.nan)
    moved[:2] = 0.0
    assert np.isnan(SkinSurface(POINTS, PLACES)(moved)).all()
    for points in (np.outer(np.arange(5.0), [1.0, 1.0]), POINTS[:2]):
        with pytest.raises(ValueError, match="do not span an area"):
            SkinSurface(points, PLACES)
