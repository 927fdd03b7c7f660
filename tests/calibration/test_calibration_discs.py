"""Tests of discs found in drawings: exact centres, and the light, noise and clutter of a rig."""

import numpy as np
import pytest
from drawn_discs import TARGET, Array, DrawnDisc, camera, draw
from numpy.typing import ArrayLike

from fingerflow.calibration import Disc, find_discs, find_hole
from fingerflow.errors import FingerflowError


def center_errors(found: list[Disc], drawn: tuple[DrawnDisc, ...]) -> Array:
    """Return the distances (N,) px from the centre of every drawn disc to the nearest found one."""
    assert found, "no disc was found"
    centers = np.array([disc.center for disc in found])
    return np.array([np.hypot(*(centers - (disc.x, disc.y)).T).min() for disc in drawn])


def check_found(image: ArrayLike, limit: float, drawn: tuple[DrawnDisc, ...] = TARGET) -> None:
    found = find_discs(image, count=10)
    assert len(found) == 3
    assert center_errors(found, drawn).max() < limit


def test_noise_free_discs_are_exact() -> None:
    """Centres are found to 0.01 px without noise, the error of the sub-pixel interpolation of the edge."""
    found = find_discs(draw(TARGET), count=10)
    assert len(found) == 3
    assert center_errors(found, TARGET).max() < 0.01
    for disc in TARGET:
        same = min(found, key=lambda other: np.hypot(other.center[0] - disc.x, other.center[1] - disc.y))
        # The blur of the lens moves the steepest point inwards by blur^2 / 2R, 0.015 px.
        np.testing.assert_allclose(same.semi_axes_px, (disc.long, disc.short), atol=0.04)
        assert abs((same.angle - disc.angle + np.pi / 2) % np.pi - np.pi / 2) < 0.01
        assert same.contrast == pytest.approx(40 / 120, abs=0.01)
        assert same.coverage == 1
        assert same.edge_rms_px < 0.02


def test_center_sigma_is_the_scatter() -> None:
    """The stated deviations of centres and radii are those of their errors within a factor of two: 8 pictures x 3 discs
    x 2 coordinates tell the ratio to about 10 %.
    """
    ratios, of_radius = [], []
    for seed in range(8):
        for disc in find_discs(camera(draw(TARGET), noise=3, seed=seed)):
            drawn = min(TARGET, key=lambda other: np.hypot(disc.center[0] - other.x, disc.center[1] - other.y))
            ratios.append(np.subtract(disc.center, (drawn.x, drawn.y)) / disc.center_sigma_px)
            of_radius.append((disc.radius_px - np.sqrt(drawn.long * drawn.short)) / disc.radius_sigma_px)
    assert len(ratios) == 24
    assert 0.5 < np.sqrt(np.mean(np.square(ratios))) < 2
    assert 0.5 < np.sqrt(np.mean(np.square(of_radius))) < 1.5


def test_uneven_light_costs_little() -> None:
    """Centres are found to 0.2 px where light falls to a quarter across the view and is curved: its curvature moves the
    steepest point.
    """
    y, x = np.mgrid[:256, :272]
    light = (0.25 + 0.75 * x / 271) * (1 - 0.4 * ((y - 128) / 128) ** 2)
    for dark in (80, 108):
        check_found(camera(draw(TARGET, dark=dark) * light, noise=0.5), 0.2)


def test_clutter_is_no_disc() -> None:
    """The three discs remain the best with dust, scratches, a bright disc, a square and the edge of the lit field."""
    levels = draw(TARGET)
    levels[20:24, :] -= 30
    levels[:, 250:] = 20
    levels[140:170, 170:200] -= 40
    levels += 40 - draw((DrawnDisc(210, 215, 22, 22),), bright=40, dark=0)
    random = np.random.default_rng(3)
    for row, column in random.integers(5, 245, (40, 2)):
        if all(np.hypot(column - disc.x, row - disc.y) > 45 for disc in TARGET):
            levels[row : row + 3, column : column + 3] -= 40
    assert center_errors(find_discs(camera(levels, noise=2), count=3), TARGET).max() < 0.05


def test_what_is_in_the_background_belongs_to_the_rig() -> None:
    stain = DrawnDisc(200.0, 200.0, 20, 20)
    frame = camera(draw((*TARGET, stain)), noise=1)
    empty = camera(draw((stain,)) * 0.8, noise=1, seed=1)
    assert len(find_discs(frame, count=10)) == 4
    found = find_discs(frame, empty, count=10)
    assert len(found) == 3
    assert center_errors(found, TARGET).max() < 0.05


def test_what_is_no_disc_is_not_found() -> None:
    """Views of one grey level or noise, a ramp and a single pixel show no disc. A disc cut in half by the border is
    left out, because half a contour gives a doubtful centre.
    """
    views = [camera(np.full((240, 320), float(level)), noise) for level, noise in ((0, 0), (255, 0), (100, 20))]
    ramp = np.tile(np.linspace(0, 255, 240), (200, 1))
    pixel = ramp.copy()
    pixel[100, 100] = 0
    for view in (*views, ramp, pixel, draw((DrawnDisc(0.0, 100.0, 25, 25),), (200, 200))):
        assert find_discs(view) == []


def test_hole_of_a_drawn_ring() -> None:
    """The hole is found in a bright ring on black with grainy metal, as in a lab; its outer edge has the other sign."""
    ring = draw((DrawnDisc(150.2, 140.7, 120, 120),), (300, 320), bright=0, dark=60)
    hole = draw((DrawnDisc(151.6, 143.3, 60, 59.4, 0.7),), (300, 320), bright=0, dark=35)
    grain = np.random.default_rng(5).normal(0, 12, ring.shape) * (ring > 30) * (hole < 17)
    found = find_hole(camera(ring - hole + grain + 10, noise=1))
    assert found.center == pytest.approx((151.6, 143.3), abs=0.15)
    assert found.radius_px == pytest.approx(np.sqrt(60 * 59.4), abs=0.15)
    assert found.axis_ratio == pytest.approx(0.99, abs=0.005)


def test_no_ring_is_said() -> None:
    with pytest.raises(FingerflowError, match="no hole of a ring"):
        find_hole(np.full((200, 200), 30.0))
