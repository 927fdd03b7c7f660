"""Dahl's friction against a numerical solution, its limits, its energy, and the printed stray factor."""

import math

import pytest
import torch
from scipy.integrate import solve_ivp
from torch import Tensor

from fingerflow.models.friction import dahl_step


def tensor(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def rate(force: float, sign: float, limit: float, n: float, stiffness: float = 500.0) -> float:
    """dF/dx of equation 7."""
    u = 1 - sign * force / limit
    return stiffness * abs(u) ** n * math.copysign(1, u)


@pytest.mark.parametrize("n", [0.0, 0.4, 0.7, 0.999999, 1.0, 1.000001, 1.5, 3.0])
@pytest.mark.parametrize(("before", "slid"), [(0.0, 3e-5), (0.02, 2e-5), (0.02, -8e-5), (-0.049, 1e-4)])
def test_the_closed_form_solves_equation_7(n: float, before: float, slid: float) -> None:
    limit, sign = 0.05, math.copysign(1, slid)

    def slope(x: float, force: list[float]) -> list[float]:
        return [sign * rate(min(max(force[0], -limit), limit), sign, limit, n)]

    expected = solve_ivp(slope, (0, abs(slid)), [before], rtol=1e-10, atol=1e-14, method="DOP853").y[0, -1]
    assert dahl_step(before, slid, limit, exponent=n).item() == pytest.approx(expected, rel=2e-7)


def test_a_slide_in_pieces_is_the_whole_slide() -> None:
    """Sticking does not depend on the step: 1 or 200 steps end at the same force, to rounding."""
    for n in (0.3, 0.7, 1.0, 2.0):
        force = torch.tensor(-0.03, dtype=torch.float64)
        for _ in range(200):
            force = dahl_step(force, 5e-7, 0.05, exponent=n)
        assert force.item() == pytest.approx(dahl_step(-0.03, 1e-4, 0.05, exponent=n).item(), rel=1e-11)


def test_the_stiffness_at_rest_is_sigma_0() -> None:
    """Without the stray factor "s" of print, by whose unit the force would be another quantity."""
    for n in (0.0, 0.7, 2.0):
        assert dahl_step(0.0, 1e-12, 0.05, exponent=n).item() == pytest.approx(500 * 1e-12, rel=1e-6)


def test_the_limit_is_kept_when_it_falls() -> None:
    force = dahl_step(0.0, 1.0, 0.05)
    assert force.item() == 0.05
    for limit in (0.04, 0.01, 1e-300, 0.0):
        force = dahl_step(force, 0.0, limit)
        assert force.item() == limit
    assert dahl_step(0.05, 1e-6, 0.0).item() == 0
    assert dahl_step(-0.05, 1e-9, 0.01).item() == pytest.approx(-0.01, rel=1e-3)


def test_never_over_the_limit() -> None:
    generator = torch.Generator().manual_seed(0)
    force = torch.zeros(2000, dtype=torch.float64)
    exponent = 3 * torch.rand(2000, generator=generator, dtype=torch.float64)
    for _ in range(50):
        slid = 1e-3 * torch.randn(2000, generator=generator, dtype=torch.float64) ** 5
        limit = torch.rand(2000, generator=generator, dtype=torch.float64) ** 4
        force = dahl_step(force, slid, limit, exponent=exponent)
        assert bool((force.abs() <= limit).all())


def test_energy_is_never_created() -> None:
    """What a random slide under a random limit takes is at least what F^2 / (2 sigma_0) gains: n from 0 to 3."""
    generator = torch.Generator().manual_seed(1)
    exponent = torch.linspace(0, 3, 13, dtype=torch.float64)
    force, energy, lost = torch.zeros(3, 13, dtype=torch.float64)
    pieces = 100
    for _ in range(20):
        slid = 2e-4 * torch.randn(13, generator=generator, dtype=torch.float64)
        limit = 0.05 * torch.rand(13, generator=generator, dtype=torch.float64)
        before = force.square() / 1000
        work = torch.zeros(13, dtype=torch.float64)
        force = dahl_step(force, 0 * slid, limit, exponent=exponent)
        cut = force.square() / 1000
        assert bool((cut <= before).all())
        for _ in range(pieces):
            after = dahl_step(force, slid / pieces, limit, exponent=exponent)
            work += (force + after) / 2 * slid / pieces  # by the trapezium, to its error
            force = after
        dissipated = work - (force.square() / 1000 - cut)
        assert bool((dissipated >= -4e-4 * work.abs()).all())
        lost += dissipated
        energy += work
    assert bool((lost[1:] > 0.1 * energy[1:].abs()).all())  # and most is lost


def test_coulomb_is_the_limit() -> None:
    """An infinite stiffness, and near it a high one, for every exponent."""
    slid = tensor(1e-6, -1e-6, 0.0)
    for n in (0.0, 0.7, 1.0):
        assert dahl_step(0.01, slid, 0.05, stiffness=math.inf, exponent=n).tolist() == [0.05, -0.05, 0.01]
        high = dahl_step(0.01, slid, 0.05, stiffness=1e9, exponent=n)
        torch.testing.assert_close(high, tensor(0.05, -0.05, 0.01), rtol=1e-8, atol=0)
    assert dahl_step(0.01, slid, 0.05, stiffness=math.inf, exponent=2.0).tolist() == [0.05, -0.05, 0.01]


def test_mirrored_motion_is_mirrored_force() -> None:
    force, slid = torch.randn(2, 99, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    turned = dahl_step(-0.01 * force, -1e-4 * slid, 0.05)
    assert torch.equal(dahl_step(0.01 * force, 1e-4 * slid, 0.05), -turned)


@pytest.mark.parametrize("n", [0.0, 0.7, 1.0, 1.6])
def test_differentiable(n: float) -> None:
    force, slid = tensor(0.01, -0.02, 0.03).requires_grad_(), tensor(1e-2, 3e-2, -2e-2).requires_grad_()
    limit, stiffness = tensor(0.05, 0.06, 0.07).requires_grad_(), tensor(0.5, 0.7, 0.9).requires_grad_()

    def step(force: Tensor, slid: Tensor, limit: Tensor, stiffness: Tensor) -> Tensor:
        return dahl_step(force, slid, limit, stiffness=stiffness, exponent=n)

    assert torch.autograd.gradcheck(step, (force, slid, limit, stiffness), eps=1e-7, atol=1e-6)
    still = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(step(force, still, 0 * limit, stiffness).sum(), still)
    assert bool(slope.isfinite().all())


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match=r"limit -0\.1"):
        dahl_step(0.0, 1.0, tensor(0.1, -0.1))
    with pytest.raises(ValueError, match=r"stiffness 0\.0: .* above 0"):
        dahl_step(0.0, 1.0, 0.1, stiffness=0.0)
    with pytest.raises(ValueError, match="exponent nan"):
        dahl_step(0.0, 1.0, 0.1, exponent=math.nan)
