"""Tests that the statistics of a simulated study agree with its design."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from fingerflow.errors import FingerflowError
from fingerflow.models.observer import FORCED_CHOICE, YES_NO
from fingerflow.report.supplement import supplement_sheet
from fingerflow.schema.trial_columns import DIFFERENCES
from fingerflow.study.figures import draw_friction_law, write_figures
from fingerflow.study.manifest import TrialEntry
from fingerflow.study.report import outliers
from fingerflow.study.row import FORCE_GRID
from fingerflow.study.statistics import read_sample, study_statistics
from fingerflow.study.table import averaged, differences
from fingerflow.study.trial_files import MEASURED, TrialRow
from tests.study.simulated_table import simulate_table


@pytest.mark.long
def test_one_study_whole() -> None:
    table = simulate_table(seed=3)
    found = study_statistics(read_sample(pd.DataFrame(table)), resamples=200)
    others = {name: one for name, one in found["observer"]["metrics"].items() if name != "divergence"}
    # The design makes divergence the best predictor: no other metric comes near in the same trials.
    assert len(others) >= 10
    for name, one in others.items():
        assert one["beside_divergence"]["interval"][1] < 0, name
    groups = found["groups"]
    assert groups["groups"] == 2
    assert [value > 0.5 for value in groups["membership"]] == [False] * 8 + [True] * 8
    assert found["by_condition"]["divergence"]["p"] < 1e-6
    assert found["by_condition"]["curl"]["p"] > 1e-3
    assert found["shares"]["divergence"]["value"] > 0.8
    assert found["force_rate"]["p"] > 1e-3
    assert (found["force_rate"]["trials"], found["force_rate"]["unit"]) == (16 * 14 * 5, "per N/s")
    test = found["by_condition"]["divergence"]
    assert (test["degrees"], test["as_printed"]["degrees"]) == ([6, 6 * 15], [6, 1568 - 7])
    for kind in ("by_condition", "by_answer", "shares"):
        assert all(one["p_holm"] >= one["p"] for one in found[kind].values())
    chosen = table["answer"] & (table["global_displacement"] <= 0.2)
    criterion, truth = found["observer"]["metrics"]["divergence"]["criterion"], table["divergence"][chosen]
    assert criterion["unit"] == "µm/mm"
    assert criterion["value"] == pytest.approx(1e3 * np.quantile(truth, 0.25))
    json.dumps(found, allow_nan=False)


@pytest.mark.long
def test_what_is_left_out_is_counted() -> None:
    frame = pd.DataFrame(simulate_table(participants=4, trials=3))
    frame["answer"] = frame["answer"].astype(object)
    frame.loc[:4, "status"] = "failed"
    frame.loc[3:9, "answer"] = None
    sample = read_sample(frame)
    assert sample.number == 84
    assert dict(sample.rules) == {
        "failed, so nothing was measured": 5,
        "no answer in the manifest": 5,
        "reference presses, which count in differences from them": 0,
    }
    assert len(sample.trials.answer) == 74
    frame["reference"] = ""
    frame["trial"] = [str(number) for number in range(84)]
    frame.loc[10, "reference"] = "5"
    assert [count for _, count in read_sample(frame).rules] == [5, 4, 1]
    frame["answer"] = None
    without = read_sample(frame)
    assert not without.answered
    assert len(without.trials.answer) == 79
    few = {name: without.trials.metrics[name] for name in ("divergence", "curl")}
    assert "observer" not in study_statistics(replace(without, trials=replace(without.trials, metrics=few)), 200)
    frame["status"] = "not run"
    with pytest.raises(FingerflowError, match="no trial has been measured"):
        read_sample(frame)


@pytest.mark.long
def test_differences_from_references_are_in_shares_groups_and_figures_alone(tmp_path: Path) -> None:
    frame = pd.DataFrame(simulate_table(participants=6, trials=2))
    frame = frame[[*list(frame)[:5], "divergence", "strain", "curl", "global_displacement", "force_angle", "max_force"]]
    frame = frame.assign(reference="")
    assert differences(frame) == {}
    assert "contact_exponent_std_difference" not in DIFFERENCES
    of_none = frame.assign(condition=-1.0, trial=100 + frame["trial"], answer=None, divergence=0.01)
    both = pd.concat((frame.assign(reference=100 + frame["trial"]), of_none), ignore_index=True)
    for name in (one.removesuffix("_difference") for one in DIFFERENCES):
        both[name] = both.get(name, np.nan)
    both = pd.concat((both, pd.DataFrame(differences(both))), axis=1)
    measured = both["answer"].notna()
    np.testing.assert_allclose(both["divergence_difference"][measured], both["divergence"][measured] - 0.01)
    assert both["divergence_difference"][~measured].isna().all()
    sample = read_sample(both)
    found = study_statistics(sample, resamples=100)
    assert len(sample.trials.answer) == len(frame)
    assert "divergence_difference" in found["shares"]
    assert not any("difference" in name for table in ("by_condition", "by_answer") for name in found[table])
    assert not any("difference" in name for name in found["observer"]["metrics"])
    medians = frame.groupby("participant")["divergence"].median().to_numpy() - 0.01
    np.testing.assert_allclose(found["groups"]["medians"], 1e3 * medians)
    curves = pd.DataFrame({name: [] for name in ("metric", "condition", "normal_force_N", "mean", "low", "high")})
    assert dict(one[:2] for one in write_figures(both, sample, curves, tmp_path))["S12"]


def test_the_curve_of_answers_follows_the_design() -> None:
    """The curve fits an observer who answers yes to fewer than half of the still stimuli only with the
    yes-no design.
    """
    trials = read_sample(pd.DataFrame(simulate_table(participants=6, trials=6, softness=(1.0, 1.0)))).trials
    for design, fits in ((FORCED_CHOICE, False), (YES_NO, True)):
        axes = supplement_sheet("S12", trials, design).figure().axes[-1]
        dots, curve = (np.asarray(line.get_ydata(), dtype=float) for line in axes.lines[:2])
        assert dots[0] < 0.4
        assert (curve[0] < 0.4) == fits
        assert f"{trials.answer.size} trials" in axes.get_legend().get_texts()[0].get_text()


def test_a_trial_that_is_far_off_is_found() -> None:
    frame = pd.DataFrame(simulate_table(participants=4, trials=4))
    frame.loc[17, "curl"] = 0.1
    found = outliers(frame)
    assert max(range(len(found)), key=lambda number: found[number][0]) == 17
    assert found[17][1] == "curl"


def test_curves_are_averaged_over_participants() -> None:
    """Curves are averaged over participants: their means 1 (three trials) and 3 (one trial) give 2, not 1.5, with t of
    one degree of freedom, 12.7062.
    """

    def trial(number: int, who: str, value: float, until: int) -> tuple[TrialEntry, TrialRow]:
        curve = [value if column < until else None for column in range(len(FORCE_GRID))]
        entry = TrialEntry(str(number), "", who, str(number), "0", None, {}, {})
        return entry, TrialRow(MEASURED, curves={"divergence": curve})

    stored = [trial(1, "a", 0.9, 10), trial(2, "a", 1.0, 10), trial(3, "a", 1.1, 10), trial(4, "b", 3.0, 20)]
    rows = averaged([*stored, (stored[3][0], TrialRow(MEASURED))])
    assert len(rows) == 10, "what fewer than half of the trials reach is left out"
    assert rows[0]["mean"] == pytest.approx(2.0)
    assert rows[0]["high"] - rows[0]["mean"] == pytest.approx(12.7062, rel=1e-4)
    assert (rows[0]["participants"], rows[0]["trials"], rows[0]["without"]) == (2, 4, 1)


def test_friction_falls_with_force_within_participants() -> None:
    """Participants with more friction press harder: pooled, friction would rise with force."""
    who, force = np.repeat(np.arange(6), 8), np.tile(np.linspace(0.5, 2, 8), 6)
    force = force * (1 + who)
    slid = pd.DataFrame({"participant": who, "friction_force": force, "friction": (1 + who) * force**-0.3})
    assert draw_friction_law(Figure().subplots(), slid).get_title().startswith("n - 1 = -0.300")
