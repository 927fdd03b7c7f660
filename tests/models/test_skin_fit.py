"""Tests of friction and stiffness fitted to simulated curves, with intervals that contain the truth."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from fingerflow.models.skin_chain import press
from fingerflow.models.skin_fit import fit_skin
from fingerflow.models.skin_parameters import PARAMETERS

LAB = PARAMETERS["lab"]
SOFTER = replace(LAB, tissue_stiffness=0.8 * LAB.tissue_stiffness, contact_stiffness=0.8 * LAB.contact_stiffness)
LOADS = torch.linspace(0.4, 4, 10, dtype=torch.float64)
ERRORS = {"divergence_error": 5e-4, "contact_error_m": 4e-5}


def curves(friction: float, skin: object, seed: int) -> tuple[Tensor, Tensor]:
    truth = press(friction, skin, LOADS, elements=201)  # type: ignore[arg-type]
    noise = torch.randn(2, 10, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return truth.divergence + 5e-4 * noise[0], truth.contact_length + 4e-5 * noise[1]


def holds(interval: tuple[float, float] | None, truth: float) -> bool:
    assert interval is not None
    return interval[0] < truth < interval[1]


def test_friction_and_stiffness_are_fitted_to_both_curves() -> None:
    kept = 0
    for seed in range(4):
        found = fit_skin(LOADS, *curves(0.06, SOFTER, seed), **ERRORS, elements=201)
        kept += holds(found.friction_interval, 0.06) + holds(found.tissue_interval, SOFTER.tissue_stiffness)
        assert found.friction == pytest.approx(0.06, rel=0.3)
        assert found.tissue_stiffness == pytest.approx(SOFTER.tissue_stiffness, rel=0.05)
        assert found.parameters.tissue_stiffness == found.tissue_stiffness
        assert 0.3 < found.misfit < 1.8
        assert found.count == 20
    assert kept >= 7  # of 8 at 95 %


def test_friction_from_divergence_alone() -> None:
    divergence, _ = curves(0.04, LAB, 5)
    divergence[3] = torch.nan
    found = fit_skin(LOADS, divergence, **ERRORS, elements=201)
    assert holds(found.friction_interval, 0.04)
    assert found.friction == pytest.approx(0.04, rel=0.2)
    assert found.tissue_interval is None
    assert found.tissue_stiffness == pytest.approx(LAB.tissue_stiffness)
    assert found.count == 9


def test_stiffness_from_contact_alone() -> None:
    _, contact = curves(0.5, SOFTER, 6)
    found = fit_skin(LOADS, None, contact, friction=0.5, **ERRORS, elements=201)
    assert holds(found.tissue_interval, SOFTER.tissue_stiffness)
    assert found.friction == pytest.approx(0.5)
    assert found.friction_interval is None


def test_a_friction_under_which_nearly_all_sticks_has_a_wide_interval() -> None:
    """If nearly all elements stick (friction 0.5) the upper end of the interval is more than three times the lower one;
    at 0.06 with the same noise it is less than twice.
    """
    ratios = []
    for friction in (0.06, 0.5):
        found = fit_skin(LOADS, *curves(friction, LAB, 7), **ERRORS, elements=201)
        assert holds(found.friction_interval, friction)
        assert found.friction_interval is not None
        ratios.append(found.friction_interval[1] / found.friction_interval[0])
    assert ratios[0] < 2
    assert ratios[1] > 3


def test_bad_curves_are_refused() -> None:
    with pytest.raises(ValueError, match=r"give \(K,\) of each"):
        fit_skin(LOADS, torch.zeros(9))
    with pytest.raises(ValueError, match="0 measured numbers"):
        fit_skin(LOADS)
    with pytest.raises(ValueError, match="2 measured numbers"):
        fit_skin(LOADS[:2], torch.zeros(2))
    with pytest.raises(ValueError, match="normal force of 0 N"):
        fit_skin(0 * LOADS, torch.zeros(10))
