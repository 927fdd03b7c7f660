"""The suite of partial slip: rendered trials, and how rows are counted."""

import pytest

from bench.rows import Cell, number
from bench.suites import slip

pytestmark = pytest.mark.long


def test_two_trials_of_each_kind() -> None:
    """All verdicts are right, d² is known in every frame, to 0.02 in nine of ten and to 0.05 in all."""
    total, *rows, straight, first, second = slip.run(quick=True)
    assert (total["trial"], total["verdict"], total["found"]) == ("all", "0 wrong, 0 none, 2 right", "of 2")
    assert (straight["trial"], straight["verdict"]) == ("linear, all", "0 wrong, 0 none, 2 right")
    assert [row["trial"] for row in rows] == ["100", "101"]
    assert [row["trial"] for row in (first, second)] == ["linear, 100", "linear, 101"]
    for row in (*rows, first, second):
        assert row["unknown"] == 0
        assert "critical" in str(row["why"])
        assert number(row, "within_002") > 90
        assert number(row, "worst") < 0.05
    for row in (first, second):
        assert abs(number(row, "critical_found") - number(row, "critical")) < 0.04
        assert abs(number(row, "duration_error")) < 0.04
    assert number(total, "worst") == max(number(row, "worst") for row in rows)


def test_trials_of_seeds_differ_and_come_back() -> None:
    first, again, other = (slip.trial(seed) for seed in (100, 100, 101))
    assert first == again
    assert first.static_friction != other.static_friction
    outcomes = {slip.trial(seed).kinetic_friction < 0.94 * slip.trial(seed).static_friction for seed in range(100, 110)}
    assert outcomes == {True, False}


def row(name: str, verdict: str, frames: int, unknown: float, within: float | None, **ratios: float) -> dict[str, Cell]:
    errors = {
        "ratio_error": None,
        "fit_error": None,
        "ratio_bound": None,
        "ratio_shift": None,
        "offset_5": None,
        **ratios,
    }
    worst = None if within is None else 0.1
    return {
        "trial": name, "verdict": verdict, "by_area": verdict != "wrong", "by_model": True, "as_printed": False,
        "frames": frames, "unknown": unknown, "within_002": within, "worst": worst, "cpu_s": 2.0, **errors,
    }  # fmt: skip


def test_rows_are_counted() -> None:
    """Shares are of frames, not of trials; a trial without d² counts as unknown, one without a ratio not at all; the
    wrong ones come first."""
    rows = [
        row("1", "right", 100, 0.0, 100.0, ratio_error=0.04, ratio_bound=0.03),
        row("2", "wrong", 50, 50.0, 0.0, ratio_error=-0.2, ratio_bound=0.05),
        row("3", "none", 50, 100.0, None),
    ]
    total, *rest = slip.summed(rows)
    assert (total["verdict"], total["found"], total["frames"]) == ("1 wrong, 1 none, 1 right", "of 3", 200)
    assert (total["by_area"], total["by_model"], total["as_printed"]) == (2, 3, 0)
    assert total["ratio_bound"] == pytest.approx(0.04)
    assert total["offset_5"] is None
    assert total["unknown"] == pytest.approx(100 * 75 / 200)
    assert total["within_002"] == pytest.approx(100 * 100 / 125)
    assert (total["worst"], total["ratio_error"], total["fit_error"]) == (0.1, 50.0, None)
    assert total["cpu_s"] == 6
    assert [one["trial"] for one in rest] == ["2", "3", "1"]
