"""Tests of forces against their energy, of the undeformed chain, and of parameter sets."""

from dataclasses import replace

import numpy as np
import pytest
from chains import bent, chain_of, energy, nodes_of
from scipy.integrate import quad

from fingerflow.models.skin_forces import Columns
from fingerflow.models.skin_parameters import PARAMETERS, parameter_set


@pytest.mark.parametrize(("parameters", "depth"), [("lab", 0.0), ("fitted", 0.0), ("fitted", 1.5e-3)])
def test_forces_are_minus_the_slopes_of_the_energy(parameters: str, depth: float) -> None:
    """The forces are the slopes of the energy and the stiffnesses those of the forces, by central differences, with
    columns stretched and compressed by up to twice c_0.
    """
    chain = chain_of(11, parameters)
    nodes, step = bent(chain), 1e-9
    nodes[3:8, 1] += depth
    assert (nodes[:-1, 1] < 0).any() or depth
    slopes, stiffness = np.zeros_like(nodes), np.zeros((len(nodes) - 1, 2))
    for at in np.ndindex(nodes.shape):
        off = np.zeros_like(nodes)
        off[at] = step
        slopes[at] = (energy(chain, nodes + off) - energy(chain, nodes - off)) / (2 * step)
        if at[0] < len(nodes) - 1:
            # The bone feels the tissue alone: neither links nor plate.
            change = Columns(chain, nodes + off).forces()[-1] - Columns(chain, nodes - off).forces()[-1]
            stiffness[at[0], at[1]] = change[at[1]] / (2 * step)
    columns = Columns(chain, nodes)
    np.testing.assert_allclose(columns.forces(), -slopes, rtol=1e-5, atol=1e-6)
    xx, _, zz = columns.slopes()
    np.testing.assert_allclose(np.stack((xx, zz), 1), stiffness, rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("compression", [-4e-4, 1e-9, 2e-3])
def test_a_column_stiffens_exponentially(compression: float) -> None:
    """A column straight above the plate pushes by the quadrature of the stiffness k_t exp(c / c_0), which stays k_t in
    a stretched one.
    """
    chain = chain_of(11, "fitted")
    nodes = nodes_of(chain)
    nodes[5, 1] += compression

    def rate(part: float, c: float) -> float:
        return part * float(np.exp(max(c, 0.0) * chain.stiffening))

    grown = rate(chain.shear, compression)
    column = quad(lambda c: rate(chain.tissue, c), 0, compression, epsabs=0, epsrel=1e-12)[0]
    bulge = grown * compression**2 / 2 * chain.stiffening * (compression > 0)
    links = 2 * chain.membrane * compression
    plate = chain.contact * max(-compression, 0.0)
    found = Columns(chain, nodes).forces()[5]
    assert found[1] == pytest.approx(plate - links - column - grown * compression - bulge, rel=1e-12)
    assert abs(found[0]) < 1e-18


def test_undeformed_is_at_rest() -> None:
    chain = chain_of()
    assert np.abs(Columns(chain, nodes_of(chain)).forces()).max() < 1e-11


def test_parameter_sets_are_those_of_print_and_of_the_lab() -> None:
    """Parameter sets equal those of the paper and of the lab's script: k_m and k_t are in kN/m (printed as "kNm"), d is
    10 mm, nu 0.48 and the nail 5 kN/m. The membrane is neither fitted nor softened.
    """
    paper, lab = PARAMETERS["paper"], PARAMETERS["lab"]
    assert (paper.membrane_stiffness, paper.tissue_stiffness, paper.damping) == (2500.0, 130.0, 0.1)
    assert lab.membrane_stiffness == pytest.approx(3063, rel=1e-3)
    assert lab.tissue_stiffness == pytest.approx(np.pi * 8e-3 * 25e3 / 2)
    assert lab.shear_stiffness == pytest.approx(lab.tissue_stiffness / 2 / 1.48)
    assert lab.nail_stiffness == 5000
    assert PARAMETERS["fitted"].membrane_stiffness == paper.membrane_stiffness
    softer = PARAMETERS["fitted"].softer(2.0)
    assert softer.membrane_stiffness == paper.membrane_stiffness
    assert softer.shear_stiffness / softer.tissue_stiffness == pytest.approx(1 / 2.8)
    assert lab.contact_stiffness == 100 * lab.tissue_stiffness
    finer = lab.for_elements(1001)
    assert finer.membrane_stiffness == 2 * lab.membrane_stiffness
    assert finer.tissue_stiffness == lab.tissue_stiffness / 2


def test_parameters_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="'mine': choose one of paper, lab"):
        parameter_set("mine")
    for name, value in (("radius", 0.0), ("tissue_stiffness", -1.0), ("stiffening", -1.0), ("damping", float("nan"))):
        with pytest.raises(ValueError, match=f"{name} is"):
            parameter_set(replace(PARAMETERS["lab"], **{name: value}))
