"""Tests of the rule by which the live page says that results fall behind the camera."""

import pytest

from fingerflow.player.keeping_up import KeepingUp


@pytest.mark.parametrize(
    ("age", "trailing", "lost", "median", "said"),
    [
        (0.01, 3, (0, 0), 4.0, ""),
        (0.4, 5, (0, 0), 4.0, "0.4 s behind"),  # few results are late, so that the median does not show it
        (0.4, 4, (0, 0), 4.0, ""),  # a camera of 10 frames/s, whose frames the tracker defers
        (0.01, 1, (0, 0), 7800.0, "7.8 s behind"),
        (7.8, 2000, (900, 0), None, "7.8 s behind"),
        (0.01, 1, (12, 3), 4.0, "12 frames lost within 1 s"),
        (0.01, 1, (0, 3), 4.0, "3 messages lost within 1 s"),
    ],
)
def test_how_results_fall_behind_is_said(
    age: float, trailing: int, lost: tuple[int, int], median: float | None, said: str
) -> None:
    rule = KeepingUp(waiting=4)
    assert rule.describe(0.0, 0.0, 0, (0, 0), None) == ""
    assert rule.describe(0.5, age, trailing, lost, median) == said
