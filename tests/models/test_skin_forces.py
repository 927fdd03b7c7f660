"""Forces against the energy they come from, slopes against forces, Dahl's friction against its own model."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from chains import bent, chain_of

from fingerflow.models.friction import dahl_step
from fingerflow.models.skin_forces import elastic_forces, elastic_slopes, energy, friction, half_circle
from fingerflow.models.skin_parameters import PARAMETERS, named
from fingerflow.models.skin_solve import Arrow


def test_forces_are_minus_the_slopes_of_the_energy() -> None:
    chain = chain_of(elements=11)
    place, bone = bent(chain)
    forces, on_bone = elastic_forces(chain, place, bone)
    assert (place[:, 1] < 0).any()
    step = 1e-9
    for i in range(11):
        for axis in range(2):
            off = np.zeros_like(place)
            off[i, axis] = step
            slope = (energy(chain, place + off, bone) - energy(chain, place - off, bone)) / (2 * step)
            assert -slope == pytest.approx(forces[i, axis], rel=1e-5, abs=1e-6)
    for axis in range(2):
        off = step * np.eye(2)[axis]
        slope = (energy(chain, place, bone + off) - energy(chain, place, bone - off)) / (2 * step)
        assert -slope == pytest.approx(on_bone[axis], rel=1e-5, abs=1e-6)


def test_undeformed_is_at_rest() -> None:
    chain = chain_of()
    forces, on_bone = elastic_forces(chain, chain.reference, np.zeros(2))
    assert np.abs(forces).max() < 1e-11
    assert np.abs(on_bone).max() < 1e-11


def test_links_pull_back_as_equation_4_does_not() -> None:
    """Printed as -k_m (U_(i-1) - 2 U_i + U_(i+1)), which would push an element further out."""
    chain = chain_of()
    moved = chain.reference.copy()
    moved[20] += (1e-5, 1e-5)
    forces, _ = elastic_forces(chain, moved, np.zeros(2))
    printed = -chain.membrane * (0 - 2 * 1e-5 + 0)
    assert (forces[20] < -chain.membrane * 1e-5).all()
    assert printed > 0
    assert forces[19] == pytest.approx(chain.membrane * np.array([1e-5, 1e-5]), rel=1e-9)


def test_the_matrix_is_the_slope_of_the_forces() -> None:
    """damping I + c K, by differences; and the solution solves it, transposed as well."""
    chain = chain_of(elements=9)
    place, bone = bent(chain)
    before = 1e-3 * np.random.default_rng(3).standard_normal(9)
    mu, old, c = np.full(9, 0.4), place + 1e-6 * np.random.default_rng(4).standard_normal(place.shape), 0.7

    def forces(place: np.ndarray, bone: np.ndarray) -> np.ndarray:
        on_elements, on_bone = elastic_forces(chain, place, bone)
        on_elements[:, 0] -= friction(chain, mu, before, old, place).force
        return np.concatenate((on_elements.ravel(), on_bone))

    matrix = np.diag(np.concatenate((np.full(18, chain.damping), np.full(2, chain.bone_damping))))
    step = 1e-11
    for k in range(20):
        off = np.zeros(20)
        off[k] = step
        move = off[:18].reshape(9, 2), off[18:]
        slope = (forces(place + move[0], bone + move[1]) - forces(place - move[0], bone - move[1])) / (2 * step)
        matrix[:, k] -= c * slope
    rubbing = friction(chain, mu, before, old, place)
    assert (rubbing.along > 0).any()
    assert (rubbing.above != 0).any()
    side = np.random.default_rng(5).standard_normal(20)
    free, one_held = np.zeros(2, dtype=bool), np.array([True, False])
    arrow = Arrow(chain, elastic_slopes(chain, place, bone), rubbing, c, free)
    for solved, exact in (
        (arrow.solve(side[:18].reshape(9, 2), side[18:]), np.linalg.solve(matrix, side)),
        (arrow.solve_transposed(side[:18].reshape(9, 2), side[18:]), np.linalg.solve(matrix.T, side)),
        (arrow.times(side[:18].reshape(9, 2), side[18:]), matrix @ side),
    ):
        found = np.concatenate((solved[0].ravel(), solved[1]))
        np.testing.assert_allclose(found, exact, rtol=2e-4, atol=2e-5 * np.abs(exact).max())
    held = Arrow(chain, elastic_slopes(chain, place, bone), rubbing, c, one_held)
    moved, motion = held.solve(side[:18].reshape(9, 2), side[18:])
    assert motion[0] == side[18]
    rows = matrix @ np.concatenate((moved.ravel(), motion)) - side
    assert np.abs(np.delete(rows, 18)).max() < 1e-3 * np.abs(side).max()


@pytest.mark.parametrize("exponent", [0.0, 0.7, 1.0, 1.8])
def test_friction_is_dahls_and_its_slopes_are_right(exponent: float) -> None:
    """Under the middle of both limits, then cut to the last; slopes by differences, where nothing switches."""
    chain = chain_of(elements=41)._replace(exponent=exponent)
    random = np.random.default_rng(7)
    old, place = (np.stack((1e-5 * random.standard_normal(41), 2e-6 * random.standard_normal(41)), 1) for _ in range(2))
    before, mu = 3e-3 * random.standard_normal(41), 0.5 + random.random(41)
    found = friction(chain, mu, before, old, place)
    limits = [mu * chain.contact * np.maximum(-z, 0) for z in (old[:, 1], place[:, 1])]
    step = dahl_step(
        *(torch.from_numpy(x) for x in (before, place[:, 0] - old[:, 0], (limits[0] + limits[1]) / 2)),
        stiffness=chain.friction_stiffness,
        exponent=exponent,
    ).numpy()
    np.testing.assert_allclose(found.force, np.clip(step, -limits[1], limits[1]), rtol=1e-9, atol=1e-12)
    assert 5 < (found.force != 0).sum() < 36
    h = 1e-12
    for axis, slope in enumerate((found.along, found.above)):
        off = h * np.eye(2)[axis]
        values = [friction(chain, mu, before, old, place + k * off).force for k in (-1, 0, 1)]
        low, high = (values[1] - values[0]) / h, (values[2] - values[1]) / h
        smooth = np.abs(high - low) < 1e-3 * (np.abs(high) + 1)
        assert smooth.sum() > 30
        np.testing.assert_allclose(slope[smooth], ((high + low) / 2)[smooth], rtol=2e-3, atol=0.5)


@pytest.mark.parametrize("count", [4, 5, 40, 501])
def test_the_half_circle_is_mirrored_to_the_last_bit(count: int) -> None:
    place = half_circle(count, 8e-3)
    assert (place[:, 0] == -place[::-1, 0]).all()
    assert (place[:, 1] == place[::-1, 1]).all()
    np.testing.assert_allclose(np.hypot(place[:, 0], place[:, 1] - 8e-3), 8e-3, rtol=1e-14)
    lengths = np.hypot(*np.diff(place, axis=0).T)
    np.testing.assert_allclose(lengths, 2 * 8e-3 * np.sin(np.pi / 2 / (count - 1)), rtol=1e-11)


def test_parameter_sets_are_those_of_print_and_of_the_lab() -> None:
    """k_m and k_t are kN/m, which print has as "kNm"; the lab's formula gives the printed k_m."""
    paper, lab = PARAMETERS["paper"], PARAMETERS["lab"]
    assert (paper.membrane_stiffness, paper.tissue_stiffness, paper.damping) == (2500.0, 130.0, 0.1)
    assert lab.membrane_stiffness == pytest.approx(1.54e6 * 8e-3 * 20e-6 / (np.pi * 8e-3 / 500) / 2)
    assert lab.membrane_stiffness == pytest.approx(2500, rel=0.03)
    assert lab.tissue_stiffness == pytest.approx(np.pi * 8e-3 * 25e3 / 2)
    assert lab.contact_stiffness == 100 * lab.tissue_stiffness
    finer = lab.for_elements(1001)
    assert finer.membrane_stiffness == 2 * lab.membrane_stiffness
    assert finer.tissue_stiffness == lab.tissue_stiffness / 2


def test_parameters_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="'mine': choose one of paper, lab"):
        named("mine")
    for name, value in (("radius", 0.0), ("tissue_stiffness", -1.0), ("poisson_ratio", 0.6), ("damping", float("nan"))):
        with pytest.raises(ValueError, match=f"{name} is"):
            named(replace(PARAMETERS["lab"], **{name: value}))
