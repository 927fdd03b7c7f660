"""Test of the numbers of the page on models, of which figures of Willemet et al. 2021 are drawn."""

import numpy as np
import pytest

from bench.papers.chain import HIGH, LOW, SimulatedPresses, simulate_presses
from fingerflow.models.skin_onset import since_onset


@pytest.fixture(scope="module")
def simulated() -> SimulatedPresses:
    return simulate_presses((0.02, LOW, HIGH), times=41, elements=251)


def test_numbers_of_the_page_on_models(simulated: SimulatedPresses) -> None:
    """Numbers of docs/methods/models.md agree with a chain of 251 elements, which is within 10 % of the page's 1001
    elements. The energy of an even stretch is its formula.
    """
    area = np.pi / 4 * (1e3 * simulated.chain.contact_length[-1].numpy()) ** 2
    np.testing.assert_allclose(area, [70.9, 67.8, 67.5], rtol=0.04)
    traction = (simulated.chain.traction[-1].abs().sum(-1) / simulated.chain.pressure[-1].sum(-1)).numpy()
    np.testing.assert_allclose(traction, [0.020, 0.115, 0.121], rtol=0.05)
    np.testing.assert_allclose(simulated.energy()[-1, 1:], [0.110, 0.031], rtol=0.25)
    divergence = since_onset(simulated.chain).area_median[-1].numpy()
    assert divergence[1] == pytest.approx(0.013, abs=0.002)
    assert abs(divergence[2]) < 0.001
