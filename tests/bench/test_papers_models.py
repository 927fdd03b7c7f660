"""Test of the numbers of the page on models, of which figures of Willemet et al. 2021 are drawn."""

import numpy as np
import pytest
import torch

from bench.papers.chain import HIGH, LOW, SimulatedPresses, simulate_presses
from bench.papers.receptors import compute_strains_at_depth
from fingerflow.models.skin_chain import follow
from fingerflow.models.skin_onset import since_onset


@pytest.fixture(scope="module")
def simulated() -> SimulatedPresses:
    return simulate_presses((0.02, LOW, HIGH), times=41, elements=251)


def test_numbers_of_the_page_on_models(simulated: SimulatedPresses) -> None:
    """Numbers of docs/methods/models.md agree with a chain of 251 elements, which is within 10 % of the page's 1001
    elements. The energy of an even stretch is its formula.
    """
    area = np.pi / 4 * (1e3 * simulated.chain.contact_length[-1].numpy()) ** 2
    np.testing.assert_allclose(area, [59.4, 54.6, 54.5], rtol=0.04)
    traction = (simulated.chain.traction[-1].abs().sum(-1) / simulated.chain.pressure[-1].sum(-1)).numpy()
    np.testing.assert_allclose(traction, [0.020, 0.094, 0.095], rtol=0.05)
    energy = simulated.energy()
    np.testing.assert_allclose(energy[-1, 1:], [0.289, 0.266], rtol=0.1)
    strain = 100 * np.median(simulated.profile()[1][:, 2], axis=-1)
    np.testing.assert_allclose(np.interp((0.5, 1, 2, 3), simulated.force, strain), [1.53, 2.23, 2.69, 2.84], rtol=0.05)
    late, early = np.interp((3, 2, 1, 0.5), simulated.force, strain).reshape(2, 2) @ (1, -1)
    assert late < early / 0.5 / 5  # the slope above 2 N, in % per N, is under a fifth of that below 1 N
    rate = simulated.rate(energy)[:, 1:]
    peak = simulated.force[np.nanargmax(rate, axis=0)]
    np.testing.assert_allclose(peak, 0.5, atol=0.2)
    middle = compute_strains_at_depth(simulated, places=3, depths=2).strain_y[-1, :, 1]
    np.testing.assert_allclose(middle, [0.0023, 0.0031, 0.0031], rtol=0.1)
    divergence = since_onset(simulated.chain).area_median[-1].numpy()
    assert divergence[1] == pytest.approx(0.0014, abs=0.001)
    assert abs(divergence[2]) < 0.0015


FORCES_N = 0.5, 1.0, 2.0, 3.0, 4.0, 5.4


def test_a_pulp_that_stiffens_has_the_areas_strains_and_energies_of_the_page() -> None:
    """The tissue is fitted to 70 mm² at 5.4 N alone, under the printed membrane. Strains flatten and energies have the
    printed size unfitted. Slippery skin stretches by some percent, not by 130.
    """
    force = torch.tensor([0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.4], dtype=torch.float64)
    frictions = 0.5, 0.16, 0.1
    chain = follow(torch.tensor(frictions), force / 3.6, force, parameters="fitted", elements=151, tolerance_m=2e-7)
    presses = SimulatedPresses(frictions, (force / 3.6).numpy(), force.numpy(), chain)
    at = np.searchsorted(presses.force, FORCES_N)
    area = np.pi / 4 * (1e3 * chain.contact_length[at, :2].numpy()).T ** 2
    np.testing.assert_allclose(area, [[17, 33, 48, 56, 62, 70], [17, 33, 48, 56, 63, 71]], rtol=0.03)
    radius, radial, hoop = (values[at] for values in presses.profile())
    strain = 50 * (radius * (radial + hoop)).sum(-1) / radius.sum(-1)
    expected = [1.5, 2.1, 2.4, 2.5, 2.7, 2.8], [1.6, 2.2, 2.5, 2.9, 3.4, 4.1]
    np.testing.assert_allclose(strain[:, :2].T, expected, rtol=0.04)
    assert strain.max() < 7
    energy = presses.energy()[at, :2].T
    expected = [0.03, 0.12, 0.21, 0.28, 0.34, 0.42], [0.03, 0.12, 0.23, 0.37, 0.57, 1.0]
    np.testing.assert_allclose(energy, expected, rtol=0.05, atol=0.005)
    assert 1 / 2 < energy[0, -1] / 0.32 < 2  # print: 0.32 mJ
