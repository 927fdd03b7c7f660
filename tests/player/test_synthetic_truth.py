"""Tests of the expected values of the synthetic finger, against its drawing and against the closed form of its
divergence.
"""

import numpy as np
import pytest
from numpy.typing import NDArray

from fingerflow.player.sources import synthetic_truth
from fingerflow.player.sources.synthetic_source import _draw_finger
from fingerflow.player.sources.synthetic_truth import Pose, expected, median_divergence

SHAPE = (192, 240)
Values = NDArray[np.float64]


@pytest.mark.parametrize("progress", [0.0, 1.0])
def test_areas_and_axes_are_those_that_are_drawn(progress: float) -> None:
    """The expected areas and axes are those of the drawn finger; ridges touch in the share of the contact in which a
    cosine is above -0.2, 0.564, to within part of a ridge.
    """
    _, lost = _draw_finger(SHAPE, progress)
    found = expected(progress, SHAPE, 0.025, int((lost > 0.5).sum()))
    rows, columns = np.nonzero(lost > 0.5)
    assert found["real_contact_area"] == pytest.approx(0.564 * found["gross_contact_area"], rel=0.05)
    widths = sorted((np.ptp(columns) + 1, np.ptp(rows) + 1), reverse=True)
    # A valley of 7 px at an end of the ellipse shortens the drawn contact.
    assert 2 * found["ellipse_major"] / 0.025 == pytest.approx(widths[0], abs=1.5)
    assert -1.5 <= 2 * found["ellipse_minor"] / 0.025 - widths[1] < 14


@pytest.mark.parametrize(("progress", "tolerance"), [(0.3, 2e-4), (0.9, 5e-3)])
def test_the_divergence_is_that_of_the_closed_form(
    progress: float, tolerance: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The median divergence of dense skin over a gauge length of 8 px is that of the closed form.

    Where most of the contact is skin that came into contact later (progress 0.9), the tolerance is 5e-3: divergence
    changes over a few px at the border of the first contact. A gauge length of 5 px comes closer, to 1.3e-3.
    """
    monkeypatch.setattr(synthetic_truth, "_SKIN", 6000)
    monkeypatch.setattr(synthetic_truth, "_MOST_SKIN", 8000)
    fitted = median_divergence(progress, 1.0, SHAPE, 8.0)
    assert fitted == pytest.approx(_closed_form(progress), abs=tolerance)


def _closed_form(progress: float) -> float:
    """Return the median of tr(F(p) G^-1) - 2 over the contact at progress p, with G = F(p0) + (dx/dp) (grad p0)^T and
    p0 the progress at onset.
    """
    now, step = Pose.reached(progress, SHAPE), 1e-5
    places = synthetic_truth._lattice(2000) * np.array(now.seen_axes())
    skin = places @ np.linalg.inv(now.deformation()).T

    low, high = np.zeros(len(skin)), np.full(len(skin), 1.0)
    for _ in range(40):
        middle = (low + high) / 2
        touched = Pose.reached(middle, SHAPE).reach(skin) < 1
        low, high = np.where(touched, low, middle), np.where(touched, middle, high)
    onset: Values = high
    then, later, before = (Pose.reached(onset + change, SHAPE) for change in (0, step, -step))
    slope = np.stack([(then.reach(skin + one) - then.reach(skin - one)) / (2 * step) for one in step * np.eye(2)], -1)
    growth = (later.reach(skin) - before.reach(skin)) / (2 * step)
    gradient = np.where(onset[:, None] > 1e-6, -slope / growth[:, None], 0)
    speed = (later.positions(skin) - before.positions(skin)) / (2 * step)
    reference = then.deformation() + speed[:, :, None] * gradient[:, None, :]
    return float(np.median(np.einsum("ij,nji->n", now.deformation(), np.linalg.inv(reference)) - 2))
