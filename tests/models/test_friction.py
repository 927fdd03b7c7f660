"""Tests of Dahl's friction: numerical solution, limits, energy, slopes, and the printed factor "s"."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fingerflow.models.friction import Array, dahl_friction


def slide(before: Array | float, slid: Array | float, last: Array | float, n: float = 0.7, first: Array | None = None,
          above: float = 0.0) -> tuple[Array, Array, Array]:  # fmt: skip
    """Return the friction after a slide (m) under a limit (N) that goes from ``first`` to ``last``, less ``above``."""
    force, way, limit = np.broadcast_arrays(*np.atleast_1d(before, slid, last))
    was = limit if first is None else first
    old, place = np.stack((0 * way, -was), 1), np.stack((way, above - limit), 1)
    return dahl_friction(force, old, place, np.ones(len(way)), exponent=n)


def rate(force: float, sign: float, limit: float, n: float, stiffness: float = 500.0) -> float:
    """Return dF/dx of equation 7."""
    u = 1 - sign * force / limit
    return stiffness * abs(u) ** n * math.copysign(1, u)


@pytest.mark.parametrize("n", [0.0, 0.7, 0.999999, 1.0, 1.000001, 3.0])
@pytest.mark.parametrize(("before", "slid"), [(0.0, 3e-5), (0.02, 2e-5), (0.02, -8e-5), (-0.049, 1e-4)])
def test_the_closed_form_solves_equation_7(n: float, before: float, slid: float) -> None:
    limit, sign = 0.05, math.copysign(1, slid)

    def slope(x: float, force: list[float]) -> list[float]:
        return [sign * rate(min(max(force[0], -limit), limit), sign, limit, n)]

    expected = solve_ivp(slope, (0, abs(slid)), [before], rtol=1e-10, atol=1e-14, method="DOP853").y[0, -1]
    assert slide(before, slid, limit, n)[0][0] == pytest.approx(expected, rel=2e-7)


@pytest.mark.parametrize("n", [0.0, 0.7, 1.0, 2.0])
def test_steps_do_not_matter_and_the_stiffness_at_rest_is_sigma_0(n: float) -> None:
    """One step and 200 steps end at the same force, and the initial stiffness is sigma_0; the printed factor "s" would
    change the dimension.
    """
    force = np.array([-0.03])
    for _ in range(200):
        force = slide(force, 5e-7, 0.05, n)[0]
    np.testing.assert_allclose(force, slide(-0.03, 1e-4, 0.05, n)[0], rtol=1e-10)
    assert slide(0.0, 1e-12, 0.05, n)[0][0] == pytest.approx(500 * 1e-12, rel=1e-3)


def test_the_limit_is_kept_when_it_falls_and_direction_is_no_matter() -> None:
    force = slide(0.0, 1.0, 0.05)[0]
    assert force == 0.05
    for limit in (0.04, 1e-100, 0.0):
        assert slide(force, 0.0, limit)[0] == limit
    draw = np.random.default_rng(0)
    before, slid, limit = 0.02 * draw.standard_normal(2000), 1e-3 * draw.standard_normal(2000) ** 5, draw.random(2000)
    for n in (0.0, 0.7, 1.3):
        found = slide(before, slid, limit**4, n, first=draw.random(2000) ** 4)[0]
        assert (np.abs(found) <= limit**4).all()
    np.testing.assert_array_equal(slide(-before, -slid, limit)[0], -slide(before, slid, limit)[0])


@pytest.mark.parametrize("n", [0.0, 0.7, 1.0, 1.8])
def test_slopes_are_those_of_the_force(n: float) -> None:
    """Slopes equal finite differences of the force away from switching points."""
    draw = np.random.default_rng(7)
    before, slid = 0.02 * draw.standard_normal(200), 1e-4 * draw.standard_normal(200)
    first, last = 0.05 * draw.random((2, 200))
    h = 1e-9

    def forces(k: float, above: float) -> Array:
        return slide(before, slid + k, last, n, first, above)[0]

    _, along, above_plate = slide(before, slid, last, n, first)
    for slope, values in (
        (along, [forces(k * h, 0.0) for k in (-1, 0, 1)]),
        (above_plate, [forces(0.0, k * h) for k in (-1, 0, 1)]),
    ):
        low, high = (values[1] - values[0]) / h, (values[2] - values[1]) / h
        smooth = np.abs(high - low) < 1e-3 * (np.abs(high) + 1e-2)
        assert smooth.sum() > 150
        assert (np.abs(slope) > 1e-2).sum() > 30
        np.testing.assert_allclose(slope[smooth], ((high + low) / 2)[smooth], rtol=2e-3, atol=1e-4)
