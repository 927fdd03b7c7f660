"""Tests of the variance of positions where the displacement is curved within a window."""

from collections.abc import Callable

import numpy as np
import pytest

from fingerflow.engines.engine import Engine, EngineSettings
from fingerflow.tracker.deviations import curvature
from fingerflow.tracker.deviations.curvature import curvature_variance

SETTINGS = EngineSettings(window_px=21, gauge_length_mm=2.0)
GRID = np.stack(np.meshgrid(np.arange(0, 240, 8.0), np.arange(0, 240, 8.0)), -1).reshape(-1, 2).astype(np.float32)
INSIDE = (np.abs(GRID - 116) < 60).all(1)


def bent(curvature_px: float, column: int) -> np.ndarray:
    """Return the positions (1, N, 2) px of points displaced in x by half the square of a coordinate times a curvature
    in 1/px.
    """
    moved = GRID.copy()
    moved[:, 0] += curvature_px / 2 * (GRID[:, column] - 116) ** 2
    return moved[None]


@pytest.mark.parametrize("column", [0, 1])
def test_deviation_is_the_stated_share_of_the_shift_by_curvature(
    make_engine: Callable[[EngineSettings], Engine], column: int
) -> None:
    """Displacement of constant curvature k shifts the mean of a window by k (n^2 - 1) / 24; the stated deviation is
    0.8 of that at every point that has neighbours on all sides, to 1 % (float32 fits).
    """
    found = curvature_variance(make_engine(SETTINGS), GRID, bent(1e-3, column))[0]
    expected = curvature._SHARE * 1e-3 * (21**2 - 1) / 24
    np.testing.assert_allclose(np.sqrt(found[INSIDE]), expected, rtol=0.01)


def test_uniform_strain_and_unknown_points_have_none(make_engine: Callable[[EngineSettings], Engine]) -> None:
    """A stretch of 5 % with rotation has no curvature: below 1e-4 px. Points without a position in the key frame, and
    all points where none is known, have the variance 0.
    """
    turned = (GRID @ np.array([[1.05, 0.1], [-0.1, 0.97]], np.float32))[None]
    assert np.sqrt(curvature_variance(make_engine(SETTINGS), GRID, turned)).max() < 1e-4
    start = GRID.copy()
    start[:5] = np.nan
    assert (curvature_variance(make_engine(SETTINGS), start, bent(1e-3, 0))[0, :5] == 0).all()
    assert (curvature_variance(make_engine(SETTINGS), start * np.nan, bent(1e-3, 0)) == 0).all()
