"""Tests of the warnings about results that a stream has not found."""

import math

import pytest

from fingerflow.player.findings import Findings


@pytest.mark.parametrize(("unknown", "warns"), [(0, False), (5, False), (6, True), (100, True)])
def test_unknown_medians_are_a_warning_where_they_are_many(unknown: int, warns: bool) -> None:
    """The sentence names the frames and the reason; it is a warning where more than one frame in twenty is concerned.
    Small contacts do not count.
    """
    findings = Findings()
    for frame in range(100):
        findings.count(frame + 50, 60, 2.0, 9.0, math.nan if frame < unknown else 0.01)
        findings.count(frame + 150, 3, 0.2, 1.0, math.nan)
    found = findings.unknown_medians()
    assert bool(found) == (unknown > 0)
    if unknown:
        frames = f"NaN in {unknown} of 100 frames with a contact of more than 8 mm2, the first is 50, the last "
        assert found.startswith(f"the median divergence is {frames}{49 + unknown}: there, points with")
    warnings = findings.missing(threshold_known=True)
    assert [one.startswith(found) for one in warnings] == [True] * warns
