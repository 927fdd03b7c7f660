"""Tests of forces against their energy, of the matrix against forces, of the undeformed chain, and of
parameter sets.
"""

from dataclasses import replace

import numpy as np
import pytest
from chains import bent, chain_of, energy, nodes_of

from fingerflow.models.friction import Friction, dahl_friction
from fingerflow.models.skin_forces import elastic_forces, half_circle
from fingerflow.models.skin_implicit import Arrow
from fingerflow.models.skin_parameters import PARAMETERS, parameter_set


def test_forces_are_minus_the_slopes_of_the_energy() -> None:
    chain = chain_of(elements=11)
    nodes, step = bent(chain), 1e-9
    assert (nodes[:-1, 1] < 0).any()
    slopes = np.zeros_like(nodes)
    for at in np.ndindex(nodes.shape):
        off = np.zeros_like(nodes)
        off[at] = step
        slopes[at] = (energy(chain, nodes + off) - energy(chain, nodes - off)) / (2 * step)
    np.testing.assert_allclose(elastic_forces(chain, nodes), -slopes, rtol=1e-5, atol=1e-6)


def test_undeformed_is_at_rest() -> None:
    chain = chain_of()
    assert np.abs(elastic_forces(chain, nodes_of(chain))).max() < 1e-11


def test_links_pull_back_as_equation_4_does_not() -> None:
    """Links pull an element back; the printed sign of -k_m (U_(i-1) - 2 U_i + U_(i+1)) would push the element further
    out.
    """
    chain = chain_of()
    nodes = nodes_of(chain)
    nodes[20] += (1e-5, 1e-5)
    forces = elastic_forces(chain, nodes)
    printed = -chain.membrane * (0 - 2 * 1e-5 + 0)
    assert (forces[20] < -chain.membrane * 1e-5).all()
    assert printed > 0
    assert forces[19] == pytest.approx(chain.membrane * np.array([1e-5, 1e-5]), rel=1e-9)


def test_the_matrix_is_the_slope_of_the_forces() -> None:
    """The matrix damping I + c K equals finite differences of the forces, and the solution solves its equations."""
    chain = chain_of(elements=9)
    nodes = bent(chain)
    before = 1e-3 * np.random.default_rng(3).standard_normal(9)
    old = nodes[:-1] + 1e-6 * np.random.default_rng(4).standard_normal((9, 2))
    steep, c = np.full(9, 0.4 * chain.contact), 0.7

    def rubbed(nodes: np.ndarray) -> Friction:
        return dahl_friction(before, old, nodes[:-1], steep, chain.friction_stiffness, chain.exponent)

    def forces(nodes: np.ndarray) -> np.ndarray:
        found = elastic_forces(chain, nodes)
        found[:-1, 0] -= rubbed(nodes).force
        return found.ravel()

    matrix = np.diag(np.broadcast_to(chain.dampers, (10, 2)).ravel())
    step = 1e-11
    for k in range(20):
        off = np.zeros(20)
        off[k] = step
        slope = (forces(nodes + off.reshape(10, 2)) - forces(nodes - off.reshape(10, 2))) / (2 * step)
        matrix[:, k] -= c * slope
    rubbing = rubbed(nodes)
    assert (rubbing.along > 0).any()
    assert (rubbing.above != 0).any()
    side = np.random.default_rng(5).standard_normal(20)
    found = Arrow(chain, nodes, rubbing, c).solve(side.reshape(10, 2)).ravel()
    exact = np.linalg.solve(matrix, side)
    np.testing.assert_allclose(found, exact, rtol=2e-4, atol=2e-5 * np.abs(exact).max())


@pytest.mark.parametrize("count", [4, 5, 40, 501])
def test_the_half_circle_is_mirrored_to_the_last_bit(count: int) -> None:
    place = half_circle(count, 8e-3)
    assert (place[:, 0] == -place[::-1, 0]).all()
    assert (place[:, 1] == place[::-1, 1]).all()
    np.testing.assert_allclose(np.hypot(place[:, 0], place[:, 1] - 8e-3), 8e-3, rtol=1e-14)
    lengths = np.hypot(*np.diff(place, axis=0).T)
    np.testing.assert_allclose(lengths, 2 * 8e-3 * np.sin(np.pi / 2 / (count - 1)), rtol=1e-11)


def test_parameter_sets_are_those_of_print_and_of_the_lab() -> None:
    """Parameter sets equal those of the paper and of the lab: k_m and k_t are in kN/m (printed as "kNm"), and the lab's
    formula gives the printed k_m.
    """
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
        parameter_set("mine")
    for name, value in (("radius", 0.0), ("tissue_stiffness", -1.0), ("poisson_ratio", 0.6), ("damping", float("nan"))):
        with pytest.raises(ValueError, match=f"{name} is"):
            parameter_set(replace(PARAMETERS["lab"], **{name: value}))
