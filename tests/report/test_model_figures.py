"""Tests of the figures of partial slip and of the observer: artists hold the numbers of the models, and
figures render.
"""

import io

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fingerflow.models import observer as observing
from fingerflow.models.partial_slip import fit_friction, judge_trial
from fingerflow.report import observer
from fingerflow.report import slip_figures as partial_slip
from fingerflow.schema.rounding import format_uncertainty
from tests.slip_trials import simulate_trial


@pytest.fixture
def axes() -> Axes:
    return Figure(layout="constrained").subplots()


def texts(axes: Axes) -> set[str]:
    """Return the texts of the legend after the whole figure has been drawn."""
    axes.figure.savefig(io.BytesIO(), format="png", dpi=40)
    legend = axes.get_legend()
    return {text.get_text() for text in legend.get_texts()} if legend else set()


def line(axes: Axes, label: str) -> np.ndarray:
    return next(np.array(line.get_data()) for line in axes.lines if line.get_label() == label)


def test_a_trial_with_its_corridor_collapse_and_fit(axes: Axes) -> None:
    trial = simulate_trial(0.8, 0.4, seed=1)
    verdict = judge_trial(trial.stuck_area, trial.load_ratio, trial.time)
    loading = verdict.loading()
    fit = fit_friction(trial.stuck_area[loading], trial.load_ratio[loading], resamples=100)
    partial_slip.draw_trial(axes, trial.stuck_area, trial.load_ratio, verdict, fit)
    collapse = f"collapse, {format_uncertainty(verdict.collapse_ms, verdict.collapse_ms_std)} ms"
    assert {"not slipped", "± 5 %", collapse} < texts(axes)
    assert len(texts(axes)) == 4
    band = next(patch for patch in axes.patches if patch.get_label() == "± 5 %").get_extents()
    edges = axes.transData.inverted().transform(band)[:, 0]
    assert edges == pytest.approx(verdict.loss_load_ratio * np.array([0.95, 1.05]))
    assert line(axes, collapse)[1][0] == pytest.approx(verdict.critical_area, abs=0.06)
    assert axes.get_title() == "vanishes abruptly"


def test_a_set_of_trials_is_counted(axes: Axes) -> None:
    trials = []
    for seed, (mu_k, reached) in enumerate(((0.3, 1.0), (0.4, 1.0), (1.1, 1.0), (0.4, 0.6))):
        trial = simulate_trial(0.8, mu_k, seed, reached=reached)
        trials.append((trial.stuck_area, trial.load_ratio, judge_trial(trial.stuck_area, trial.load_ratio, trial.time)))
    partial_slip.draw_trials(axes, trials)
    assert texts(axes) == {"± 5 %", "vanishes abruptly: 2", "diminishes: 1", "inconclusive: 1"}
    assert len(axes.lines) == 3 + 3


def test_the_ideal_observer(axes: Axes) -> None:
    draw = np.random.default_rng(0)
    found = observing.printed_observer(14 + 4 * draw.standard_normal(400), 9 + 4 * draw.standard_normal(200))
    observer.draw_counts(axes, found, "divergence")
    assert texts(axes) == {"correct", "incorrect"}
    assert f"{found.d_prime:.2f}" in axes.get_title()
    assert axes.patches[0].get_data().values.sum() == 400
    roc = Figure().subplots()
    observer.draw_roc(roc, {"divergence": found})
    assert texts(roc) == {f"divergence ({found.auc:.2f})"}
    table = Figure().subplots()
    who = np.arange(50) % 10, np.arange(40) % 10
    estimate = observing.auc(draw.standard_normal(50) + 1, draw.standard_normal(40), who)
    observer.draw_estimates(table, {"divergence": estimate}, "area under the ROC", 0.5)
    assert texts(table) == set()
    assert tuple(table.lines[0].get_xdata()) == estimate.interval
    assert "n 90" in table.texts[0].get_text()


def test_groups_and_their_psychometric_curves(axes: Axes) -> None:
    draw = np.random.default_rng(1)
    values = np.append(draw.normal(8, 1, 10), draw.normal(16, 1, 8))
    groups = observing.participant_groups(values, resamples=100)
    observer.draw_groups(axes, values, groups, "divergence (µm/mm)")
    texts(axes)
    assert axes.get_title().startswith("2 groups")
    assert axes.lines[-1].get_xdata()[0] == groups.border
    x, answers, trials = np.linspace(0, 3, 5), [20, 22, 30, 37, 39], np.full(5, 40)
    fit = observing.fit_psychometric(x, answers, trials, np.arange(5), guess=0.5)
    curves = Figure().subplots()
    observer.draw_psychometric(curves, {"softer": (x, answers, trials, fit)}, "amplitude (µm)")
    assert texts(curves) == {"softer, 200 trials"}
    np.testing.assert_allclose(curves.lines[1].get_ydata()[[0, -1]], fit([0, 3]))
