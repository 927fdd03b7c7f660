"""Tests of the figures of a table of trials: artists hold the numbers of the table."""

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats

from fingerflow.errors import FingerflowError
from fingerflow.models.observer import Trials, read_trials, repeated_anova
from fingerflow.report import trial_metrics as metrics

FOUR = {"participant": ["p"] * 4, "trial": [1, 2, 3, 4], "condition": [0] * 4, "answer": [True] * 4,
        "curl": [1e-3, 2e-3, 3e-3, 4.1e-3], "strain": [1e-3, 2e-3, 3e-3, 4e-3]}  # fmt: skip
AMPLITUDES = (0.0, 1.0, 2.0)


def table(rows: int = 20) -> Trials:
    """Return trials of 4 participants and 3 amplitudes, whose area is 10 times the participant's number and falls with
    amplitude.
    """
    draw = np.random.default_rng(0)
    who, amplitude, trial = map(np.ravel, np.meshgrid(range(1, 5), AMPLITUDES, range(rows), indexing="ij"))
    spread, noise = 0.001 * draw.standard_normal((2, who.size))
    divergence = 0.01 + 0.005 * amplitude + spread
    return read_trials({
        "participant": np.char.add("p", who.astype(str)), "trial": trial, "condition": amplitude,
        "answer": draw.random(who.size) < 0.5 + 0.2 * amplitude, "max_force": 5 + draw.standard_normal(who.size),
        "real_contact_area": 10 * who * (1 - 0.1 * amplitude), "force_angle": np.full(who.size, 0.1),
        "divergence": divergence, "strain": 0.4 * divergence + 0.001 + 0.001 * noise,
    })  # fmt: skip


@pytest.fixture(scope="module")
def trials() -> Trials:
    return table()


@pytest.fixture
def axes() -> Axes:
    return Figure(layout="constrained").subplots()


def test_a_distribution(axes: Axes, trials: Trials) -> None:
    metrics.draw_distribution(axes, trials, "max_force")
    assert sum(patch.get_height() for patch in axes.patches[:-1]) == 240
    force = trials.metrics["max_force"]
    assert axes.lines[0].get_xdata()[0] == pytest.approx(force.mean())
    assert axes.get_title() == f"{force.mean():.3g} ± {force.std(ddof=1):.2g}, 240 trials"


def test_an_influence_that_is_none(axes: Axes, trials: Trials) -> None:
    metrics.draw_influence(axes, trials, "max_force")
    shares = np.asarray(axes.lines[0].get_ydata(), dtype=float)
    assert shares.size == 8
    assert shares.mean() == pytest.approx(trials.answer.mean())
    (low, high) = zip(*(segment[:, 1] for segment in axes.collections[0].get_segments()), strict=True)
    assert (np.array(low) < shares).all()
    assert (shares < np.array(high)).all()
    test = repeated_anova(trials.metrics["max_force"], trials.answer, trials.participant)
    assert axes.get_title() == f"F(1, 3) = {test.f:.1f}, p = {test.p:.3f}"


def test_areas_over_the_participants_own(axes: Axes, trials: Trials) -> None:
    metrics.draw_by_condition(axes, trials, "real_contact_area", normalised=True)
    medians = [line.get_ydata()[0] for line in axes.lines if line.get_linewidth() == 2]
    assert medians == pytest.approx([1 / 0.9, 1, 0.8 / 0.9])
    assert "real contact area over own median" in axes.get_ylabel()
    angle = Figure().subplots()
    metrics.draw_by_condition(angle, trials, "force_angle")
    assert angle.lines[-1].get_ydata()[0] == pytest.approx(np.rad2deg(0.1))


def test_shares_against_the_median_metric(axes: Axes, trials: Trials) -> None:
    metrics.draw_share_against(axes, trials, "divergence")
    assert [line.get_label() for line in axes.lines] == ["0", "1", "2"]
    own = (trials.participant == "p1") & (trials.condition == 2)
    assert axes.lines[2].get_xdata()[0] == pytest.approx(1e3 * np.median(trials.metrics["divergence"][own]))
    assert axes.lines[2].get_ydata()[0] == pytest.approx(trials.answer[own].mean())
    dots = np.concatenate([line.get_data() for line in axes.lines], axis=1)
    assert f"Spearman {stats.spearmanr(*dots).statistic:.2f}" in axes.get_title()
    brightness = [np.sum(line.get_color()[:3]) for line in axes.lines]
    assert brightness == sorted(brightness)


def test_a_correlation_has_its_line(axes: Axes) -> None:
    trials = table()
    metrics.draw_correlation(axes, trials, "divergence", "strain")
    x, y = axes.lines[-1].get_data()
    assert (y[1] - y[0]) / (x[1] - x[0]) == pytest.approx(0.4, rel=1e-3)
    assert float(axes.get_title().split()[1]) == pytest.approx(0.4, rel=1e-3)
    assert axes.get_title().endswith("R² = 1.00")
    assert len({tuple(line.get_color()) for line in axes.lines[:-1]}) == 4
    assert len({line.get_marker() for line in axes.lines[:-1]}) == 4
    trials.metrics["strain"][0] += 1
    metrics.draw_correlation(axes, trials, "divergence", "strain")  # one far trial does not turn the line
    assert float(axes.get_title().split()[1]) == pytest.approx(0.4, rel=1e-2)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_few_trials_have_no_line(count: int, axes: Axes) -> None:
    """No slope and no R² is stated for few trials of one participant, which may lie on a line by chance."""
    few = read_trials({name: np.array(values[:count]) for name, values in FOUR.items()})
    metrics.draw_correlation(axes, few, "curl", "strain")
    assert axes.get_title().startswith("no line: ")
    assert len(axes.lines) == 1


def test_a_metric_that_is_not_there(axes: Axes, trials: Trials) -> None:
    with pytest.raises(FingerflowError, match="no metric 'duration': it has max_force"):
        metrics.draw_distribution(axes, trials, "duration")
