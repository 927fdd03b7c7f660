"""Tests of the store of simulated studies: stored presses are reused while the code still gives their metrics."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.suites import simulated_studies
from fingerflow.report.supplement import OBSERVED
from fingerflow.study.simulated_trials import Design, Presses

pytestmark = pytest.mark.long  # the presses of a design are drawn from many solved contacts

DESIGN = replace(simulated_studies.DESIGN, participants=2, amplitudes=(0.0, 3.0))
OTHER = replace(DESIGN, seed=1)
PRESSES = 4


class _Measurement:
    """Measurement of presses whose metrics are a known function of the number of the press and of a `scale`, which
    stands for the state of renderer and pipeline.
    """

    def __init__(self) -> None:
        self.scale = 1.0
        self.presses: list[tuple[int, int]] = []  # study and press of each measurement

    def __call__(self, design: Design, presses: Presses, number: int) -> dict[str, float]:
        self.presses.append((design.seed, number))
        known = {name: self.scale * (number + 1 + place) / 7 for place, name in enumerate(OBSERVED)}
        return known | {OBSERVED[0]: np.nan if number == 0 else known[OBSERVED[0]]}


@pytest.fixture
def measurement(monkeypatch: pytest.MonkeyPatch) -> _Measurement:
    """Return a measurement that takes the place of rendering and processing."""
    made = _Measurement()
    monkeypatch.setattr(simulated_studies, "_metrics", made)
    return made


def test_changed_metrics_discard_the_stored_presses_of_their_study(measurement: _Measurement, tmp_path: Path) -> None:
    store = tmp_path / "presses.csv"
    simulated_studies.measured(DESIGN, store)
    simulated_studies.measured(OTHER, store)
    others = [line for line in store.read_text(encoding="utf-8").splitlines() if line.split(",")[1] == "1"]
    measurement.presses.clear()
    measurement.scale = 1.001
    found = simulated_studies.measured(DESIGN, store)
    assert measurement.presses == [(0, number) for number in range(PRESSES)]
    np.testing.assert_allclose(found[OBSERVED[1]], 1.001 * np.arange(2, PRESSES + 2) / 7, rtol=1e-5)
    lines = store.read_text(encoding="utf-8").splitlines()
    assert lines[1 : len(others) + 1] == others  # another study stays as it was
    assert len(lines) == 1 + 2 * PRESSES
    simulated_studies.measured(DESIGN, store)
    assert measurement.presses[PRESSES:] == [(0, 0)]
