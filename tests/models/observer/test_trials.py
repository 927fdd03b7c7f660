"""Tests of the table of trials, and of the ideal observer as printed in the paper."""

import math
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.special import ndtr

from fingerflow.errors import FingerflowError
from fingerflow.models.observer import d_prime, leave_out_moved, observe, printed_observer, read_trials


def table(**columns: Any) -> dict[str, Any]:
    rows = {
        "participant": ["a", "a", "b", "b"], "trial": [1, 2, 1, 2], "condition": [0.5, 1.0, 0.5, 1.0],
        "answer": [True, False, True, True], "divergence": [10.0, 4.0, np.nan, 12.0],
        "global_displacement": [0.1, 0.3, 0.2, np.nan], "force_angle": [5.0, 6.0, 7.0, 8.0],
    }  # fmt: skip
    return {**rows, **columns}


@pytest.mark.parametrize("kind", [dict, pd.DataFrame])
def test_a_table_is_a_mapping_or_a_data_frame(kind: type) -> None:
    trials = read_trials(kind(table()))
    correct, incorrect = trials.split("divergence")
    np.testing.assert_array_equal(correct, [10, np.nan, 12])
    np.testing.assert_array_equal(incorrect, [4])
    assert [list(who) for who in trials.participants()] == [["a", "b", "b"], ["a"]]
    assert set(trials.metrics) == {"divergence", "global_displacement", "force_angle"}


def test_trials_of_fingers_that_slid_are_nan_and_counted() -> None:
    """Trials in which the finger slid further than the limit, or by an unknown distance, become NaN and are counted."""
    trials = leave_out_moved(read_trials(table()))
    np.testing.assert_array_equal(trials.metrics["divergence"], [10, np.nan, np.nan, np.nan])
    np.testing.assert_array_equal(trials.metrics["global_displacement"], [0.1, 0.3, 0.2, np.nan])
    np.testing.assert_array_equal(trials.metrics["force_angle"], [5, 6, 7, 8])
    assert (trials.left_out, "0.2 mm" in trials.rule) == (2, True)


def test_tables_that_cannot_be_read() -> None:
    whole = read_trials(table())
    for wrong, message in (
        ({"answer": [1, 0, 2, 1]}, "an answer is 2: give True where it was correct"),
        ({"trial": [1, 1, 1, 2], "condition": [1] * 4}, "trial 1 of participant a, condition 1, is in the table twice"),
        ({"divergence": ["a", "b", "c", "d"]}, "metric 'divergence' is not of numbers"),
        ({"divergence": [1.0, np.inf, 1.0, 1.0]}, "'divergence' is infinite in trial 1"),
        ({"divergence": [1.0]}, "column 'divergence' has shape"),
    ):
        with pytest.raises(FingerflowError, match=message):
            read_trials(table(**wrong))
    with pytest.raises(FingerflowError, match="lacks condition, answer: it has participant, trial"):
        read_trials({"participant": [1], "trial": [1]})
    with pytest.raises(FingerflowError, match="no metric 'curl': it has divergence"):
        whole.split("curl")
    del whole.metrics["global_displacement"]
    with pytest.raises(FingerflowError, match="no global_displacement"):
        leave_out_moved(whole)


def test_the_printed_observer_on_gaussians() -> None:
    draw = np.random.default_rng(1)
    correct, incorrect = 14 + 3 * draw.standard_normal(4000), 10 + 4 * draw.standard_normal(3000)
    found = printed_observer(correct, incorrect)
    assert found.scale == pytest.approx(np.quantile(np.concatenate([correct, incorrect]), 0.9))
    np.testing.assert_allclose(np.diff(found.bins), 0.05)
    assert (found.counts_correct.sum(), found.counts_incorrect.sum()) == (4000, 3000)
    assert found.d_prime == pytest.approx(4 / math.sqrt(12.5), abs=0.06)
    who = np.arange(4000) % 9, np.arange(3000) % 9
    assert found.d_prime == pytest.approx(d_prime(correct, incorrect, who).value, abs=0.06)
    assert found.auc == pytest.approx(ndtr(4 / 5), abs=0.01)
    # With criteria from 0 to 1 only, as printed, the curve would end at the hits and false alarms of a criterion of 1.
    assert found.hits[0] == found.false_alarms[0] == 1
    assert found.hits[-1] == found.false_alarms[-1] == 0


def test_the_printed_observer_without_trials_to_fit() -> None:
    for correct, incorrect, reason in (
        ([1.0, 2.0], [], "2 correct and 0 incorrect trials"),
        ([0.0, 0.0], [0.0], "the 0.9 quantile is 0"),
        ([1.0, 1.0], [1.0, 1.0], "no Gaussian fits"),
    ):
        found = printed_observer(correct, incorrect)
        assert math.isnan(found.d_prime)
        assert reason in found.reason


def test_every_metric_beside_the_others() -> None:
    draw = np.random.default_rng(2)
    who, answer = np.repeat(np.arange(12), 30), draw.random(360) < 0.7
    trials = read_trials({
        "participant": who, "trial": np.arange(360), "condition": np.zeros(360), "answer": answer,
        "divergence": 12 + 5 * answer + 4 * draw.standard_normal(360), "force_rate": 5 + draw.standard_normal(360),
        "global_displacement": 0.1 * np.abs(draw.standard_normal(360)),
    })  # fmt: skip
    left = leave_out_moved(trials)
    found = observe(left, permutations=300, seed=4)
    assert list(found) == ["divergence", "force_rate", "global_displacement"]
    moved = (trials.metrics["global_displacement"] > 0.2).sum()
    assert found["divergence"].d_prime.missing == left.left_out == moved > 5
    assert found["divergence"].auc.interval[0] > 0.7 > 0.6 > found["force_rate"].auc.interval[1]
    assert found["divergence"].auc.p < 0.01 < found["force_rate"].auc.p
    common = {one.auc.trials for one in found.values()} | {sum(one.printed.trials) for one in found.values()}
    assert common == {360 - left.left_out}
    assert found["divergence"].false_alarms.trials == sum(~answer & ~np.isnan(left.metrics["divergence"]))
    left.metrics["curl"] = np.where(np.arange(360) < 200, np.nan, left.metrics["force_rate"])
    rare = observe(left, ["divergence", "curl"], permutations=100)
    assert rare["divergence"].auc == observe(left, ["divergence"], permutations=100)["divergence"].auc
    assert rare["curl"].auc.trials < 160
