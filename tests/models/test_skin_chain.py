"""Tests of a press of the skin chain: balance, symmetry, convergence, dissipative friction, and the same rest by
another method.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from chains import begun, chain_of, constant_load, energy, nodes_of, runge_kutta

from fingerflow.models import skin_implicit
from fingerflow.models.skin_chain import PressedChain, follow, press
from fingerflow.models.skin_parameters import PARAMETERS

LAB = PARAMETERS["lab"]
FRICTIONS = torch.tensor([0.0, 0.05, 0.2, 0.6, 1.5], dtype=torch.float64)


@pytest.fixture(scope="module", params=["lab", "paper"])
def pressed(request: pytest.FixtureRequest) -> PressedChain:
    return press(FRICTIONS, request.param, elements=201)


def test_forces_balance_to_a_millionth_of_the_load(pressed: PressedChain) -> None:
    assert pressed.balance.max() < 1e-6 * 3
    torch.testing.assert_close(pressed.normal_force.sum(-1), torch.full((5,), 3.0).double(), rtol=1e-6, atol=0)
    assert pressed.friction_force.sum(-1).abs().max() < 1e-12


def test_friction_points_against_the_motion(pressed: PressedChain) -> None:
    """Friction opposes the motion; friction in the published script acts along the motion, so the edge of the contact
    moves further.
    """
    away = pressed.displacement[1:, :, 0]
    force = pressed.friction_force[1:]
    strong = force.abs() > 0.05 * force.abs().amax(-1, keepdim=True)
    assert strong.sum() > 100
    assert bool((force * away <= 0)[strong].all())
    assert bool((force.abs() <= pressed.coefficient[1:] * pressed.normal_force[1:] * (1 + 1e-12)).all())
    assert pressed.friction_force[0].abs().max() == 0


def test_pressure_is_force_over_area(pressed: PressedChain) -> None:
    edges, pressure, traction = pressed.strips()
    width = 10e-3
    carried = (pressure * edges.diff(dim=-1)).sum(-1) * width
    torch.testing.assert_close(carried, torch.full((5,), 3.0).double(), rtol=1e-6, atol=0)
    torch.testing.assert_close(
        (traction.abs() * edges.diff(dim=-1)).sum(-1) * width, pressed.friction_force.abs().sum(-1), rtol=1e-9, atol=0
    )


def test_a_batch_is_its_presses_one_by_one() -> None:
    together = press(FRICTIONS, elements=61)
    for k in (0, 4):
        alone = press(FRICTIONS[k].item(), elements=61)
        assert alone.divergence.shape == ()
        torch.testing.assert_close(together.position[k], alone.position, rtol=0, atol=1e-13)
        assert together.steps[k] == alone.steps


@pytest.mark.long
def test_converges_with_the_number_of_elements() -> None:
    """Errors at the positions of 101 elements, relative to 1601 elements, fall with an order near 2 (contact begins
    between elements).
    """
    counts = (101, 201, 401, 801)
    fine = press(0.3, elements=1601, tolerance_m=2e-8).position[::16]
    errors = [
        (press(0.3, elements=n, tolerance_m=2e-8).position[:: (n - 1) // 100] - fine).square().mean().sqrt().item()
        for n in counts
    ]
    assert 1.3 < (-np.polyfit(np.log(counts), np.log(errors), 1)[0]) < 2.7, errors
    assert errors[-1] < 2e-8


@pytest.mark.long
def test_the_same_rest_by_explicit_runge_kutta() -> None:
    """SciPy's Runge-Kutta method of order 5 gives the same positions to 10 nm and the same friction
    forces after 30 ms.
    """
    chain = chain_of(elements=41)._replace(bone_damping=5.0)  # a slowly moving bone: longer steps are stable
    mu, load, implicit = np.full(41, 0.3), constant_load(3.0), begun(chain)
    skin_implicit.advance(chain, implicit, mu, load, 0.03, 1e-9, 0.0)
    place, rubbed = runge_kutta(chain, mu, load[0], 0.03)
    assert np.abs(place - implicit.nodes[:-1]).max() < 1e-8
    assert np.abs(rubbed - implicit.friction).max() < 3e-5
    assert np.abs(place - chain.reference).max() > 1e-4


def test_energy_is_only_lost() -> None:
    """The work of the load equals the stored energy plus the losses in dampers and friction, and friction never returns
    energy in any step.
    """
    chain = chain_of(elements=61)
    mu, load, state = np.full(61, 0.15), constant_load(3.0, along=0.3), begun(chain)
    nodes, rubbed = nodes_of(chain), np.zeros(61)
    lost, damped, worst = 0.0, 0.0, 0.0
    for span in np.diff(np.concatenate(([0.0], np.geomspace(1e-7, 0.05, 400)))):
        skin_implicit.advance(chain, state, mu, load, span, 2e-9, 0.0)
        taken = (rubbed + state.friction) / 2 * (state.nodes - nodes)[:-1, 0]  # by the trapezoidal rule
        gained = (state.friction**2 - rubbed**2) / (2 * chain.friction_stiffness)
        worst = min(worst, float((taken - gained).sum()))
        lost += float(taken.sum())
        damped += float((chain.dampers * np.square(state.nodes - nodes)).sum()) / span
        nodes, rubbed = state.nodes, state.friction
    work = float(load[0] @ nodes[-1])
    assert lost > 0.003 * work > 0
    assert worst > -1e-4 * lost
    assert energy(chain, nodes) + damped + lost == pytest.approx(work, rel=0.02)


def test_a_tangential_load_is_carried_by_friction() -> None:
    pulled = press(0.8, elements=101, tangential_n=0.5)
    assert pulled.balance < 1e-6 * 3.5
    assert pulled.friction_force.sum().item() == pytest.approx(-0.5, rel=1e-6)
    assert pulled.bone[0] > 0
    over = press(0.1, elements=41, tangential_n=1.0, longest_s=0.02)
    assert over.balance > 0.1  # not at rest: the balance shows it
    assert over.friction_force.sum().item() == pytest.approx(-0.3, rel=0.02)


def test_a_force_trace() -> None:
    """A force trace to 3 N and back is followed, alone and in a batch."""
    time = torch.tensor([0.0, 0.5, 1.0, 1.5], dtype=torch.float64)
    load = torch.tensor([0.0, 3.0, 3.0, 0.0], dtype=torch.float64)
    found = follow(1.0, time, load, elements=101)
    assert found.position.shape == (4, 101, 2)
    assert found.time.tolist() == pytest.approx(time.tolist())
    assert found.normal_force.sum(-1).tolist() == pytest.approx([0, 3, 3, 0], abs=0.05)
    assert math.isnan(found.divergence[0])
    batch = follow(torch.tensor([0.1, 1.0]), time, load, elements=101)
    torch.testing.assert_close(batch.position[:, 1], found.position, rtol=0, atol=1e-13)


def test_what_has_no_derivative_says_so() -> None:
    for call in (
        lambda needed: press(needed, elements=11),
        lambda needed: press(0.1, replace(LAB, radius=needed), elements=11),
        lambda needed: follow(0.1, torch.tensor([0.0, 0.1]), needed, elements=11),
    ):
        for derivative in (torch.func.grad(call), torch.func.jacfwd(call)):
            with pytest.raises(ValueError, match="a press has no gradient: detach"):
                derivative(torch.tensor(0.1))


def test_the_frictionless_press_nears_the_half_sphere_laid_flat() -> None:
    """The contact length of a frictionless press nears the geometry of the indentation, a^2 = 2 R delta for skin
    without links.
    """
    found = press(0.0, load_n=torch.tensor([0.25, 1.0, 3.0], dtype=torch.float64))
    flat = 2 * (2 * 8e-3 * -found.bone[:, 1]).sqrt()
    short = 1 - found.contact_length / flat  # links carry part of the load at the edge over 3 elements
    assert bool((short > 0).all() & (short < 0.15).all() & (short.diff() < 0).all())
    # A bed of springs under a parabola: the force grows with the indentation to the power 1.5.
    power = (found.normal_force.sum(-1).log().diff() / (-found.bone[:, 1]).log().diff()).tolist()
    assert power == pytest.approx([1.5, 1.5], abs=0.06)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"friction": -0.1}, r"friction -0\.1: a coefficient is 0 or more"),
        ({"friction": math.nan}, "friction nan"),
        ({"friction": 0.1, "parameters": "none"}, "'none': choose one of"),
        ({"friction": 0.1, "elements": 3}, "give 4 or more"),
        ({"friction": 0.1, "load_n": math.nan}, "not finite"),
    ],
)
def test_bad_input_is_refused(arguments: dict[str, object], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        press(**arguments)  # type: ignore[arg-type]
