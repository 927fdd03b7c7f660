"""Tests of the expected values of the synthetic finger, against its drawing."""

import numpy as np
import pytest

from fingerflow.player.sources.synthetic_source import _draw_finger, expected

SHAPE = (192, 240)


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
