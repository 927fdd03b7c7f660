"""Tests of forces against their energy, of the undeformed chain, and of parameter sets."""

from dataclasses import replace

import numpy as np
import pytest
from chains import bent, chain_of, energy, nodes_of

from fingerflow.models.skin_forces import elastic_forces
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
