"""Figures of the supplement of Willemet et al. 2021 that a table of trials supports."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import NDArray

from fingerflow.models.observer import FORCED_CHOICE, GUESSES, Trials, fit_psychometric, observe, participant_groups
from fingerflow.models.observer.trials_table import COLUMNS, leave_out_moved
from fingerflow.report import trial_metrics
from fingerflow.report.observer import draw_counts, draw_estimates, draw_groups, draw_psychometric, draw_roc
from fingerflow.report.sheet import Sheet, SheetPanel
from fingerflow.report.trial_metrics import AMPLITUDE, metric_label, participant_medians
from fingerflow.schema.trial_columns import DIFFERENCE

Panels = tuple[tuple[str, Callable[..., Any], tuple[str, ...]], ...]

#: Metrics shown in figure S11.
OBSERVED = (
    "divergence", "force_angle", "global_displacement", "strain_rate", "strain_energy", "force_rate",
    "real_contact_area",
)  # fmt: skip
_FEWEST_AMPLITUDES = 3
_RECORDINGS = "pictures and series of recordings, which no table of trials holds"
_NORMALISED = partial(trial_metrics.draw_by_condition, normalised=True)

# Title, letters of the printed panels that need recordings, and the panels drawn from the table of trials: letter,
# function and metrics. A difference from the reference trial gives way to the metric itself where it has no values.
_OF_METRICS: dict[str, tuple[str, str, Panels]] = {
    "S1": ("friction and contact area", "CE", (
        ("D", _NORMALISED, ("gross_contact_area",)),
        ("F", _NORMALISED, ("real_contact_area",)),
    )),
    "S5": ("force and motion of the trials", "AK", (
        ("B", trial_metrics.draw_distribution, ("max_force",)),
        ("C", trial_metrics.draw_distribution, ("time_to_max_force",)),
        ("D", trial_metrics.draw_distribution, ("duration",)),
        ("E", trial_metrics.draw_influence, ("max_force",)),
        ("F", trial_metrics.draw_influence, ("time_to_max_force",)),
        ("G", trial_metrics.draw_influence, ("duration",)),
        ("H", trial_metrics.draw_distribution, ("force_rate",)),
        ("I", trial_metrics.draw_influence_by_condition, ("force_rate",)),
        ("J", trial_metrics.draw_by_condition, ("max_displacement",)),
    )),
    "S7": ("displacement and force angle", "", (
        ("A", trial_metrics.draw_by_condition, ("global_displacement",)),
        ("B", trial_metrics.draw_by_condition, ("force_angle",)),
        ("C", trial_metrics.draw_share_against, ("global_displacement",)),
        ("D", trial_metrics.draw_share_against, ("force_angle" + DIFFERENCE,)),
        ("E", trial_metrics.draw_share_against, ("real_contact_area" + DIFFERENCE,)),
    )),
    "S8": ("strain of the surface", "ABCDEF", (
        ("G", trial_metrics.draw_correlation, ("divergence", "strain")),
        ("H", trial_metrics.draw_share_against, ("strain" + DIFFERENCE,)),
        ("I", trial_metrics.draw_share_against, ("strain_rate",)),
    )),
    "S9": ("strain energy", "ABC", (
        ("D", trial_metrics.draw_correlation, ("divergence", "strain_energy")),
        ("E", trial_metrics.draw_share_against, ("strain_energy" + DIFFERENCE,)),
    )),
    "S13": ("curl of the displacement", "AB", (("C", trial_metrics.draw_medians, ("divergence", "curl")),)),
}  # fmt: skip
#: Names of the figures.
FIGURES = ("S1", "S5", "S7", "S8", "S9", "S11", "S12", "S13")


def supplement_sheet(name: str, trials: Trials, design: str = FORCED_CHOICE) -> Sheet:
    """Return a figure of the supplement, one of FIGURES, with the panels for which the table of trials has values;
    `design` is that of the experiment, a name in GUESSES.
    """
    if name == "S11":
        return _ideal_observer(trials)
    if name == "S12":
        return _individual_performance(trials, design)
    title, of_recordings, drawn = _OF_METRICS[name]
    panels, left_out = [], [(letter, _RECORDINGS) for letter in of_recordings]
    for letter, draw, names in drawn:
        metrics = [_measured_name(trials, metric) for metric in names]
        if lacks := _missing(trials, *metrics):
            left_out.append((letter, lacks))
        else:
            panels.append(SheetPanel.single(letter, draw, trials, *metrics))
    return Sheet(name, tuple(panels), tuple(left_out), title)


def _ideal_observer(trials: Trials) -> Sheet:
    """Return figure S11: the ideal observer for each metric of the paper, from trials without gross slip."""
    metrics = [name for name in OBSERVED if not _missing(trials, name)]
    lacks = _missing(trials, *OBSERVED)
    if not metrics:
        return Sheet("S11", (), (("it", lacks),))
    if "global_displacement" in trials.metrics:
        trials = leave_out_moved(trials)
    ideal = {name.replace("_", " "): seen for name, seen in observe(trials, metrics).items()}
    printed = {name: seen.printed for name, seen in ideal.items()}
    first = next(iter(ideal))
    panels = (
        SheetPanel.single("A", draw_counts, printed[first], first),
        SheetPanel.single("B", draw_roc, printed, columns=2),
        SheetPanel.single("C, d'", draw_estimates, {name: seen.d_prime for name, seen in ideal.items()}, "d'", 0),
        SheetPanel.single(
            "C, AUC", draw_estimates, {name: seen.auc for name, seen in ideal.items()}, "area under the ROC", 0.5
        ),
    )
    return Sheet("S11", panels, (("the rest", lacks),) if lacks else (), "ideal observer of each metric")


def _individual_performance(trials: Trials, design: str) -> Sheet:
    """Return figure S12: groups of participants by median divergence (or its difference), and their answers."""
    metric = _measured_name(trials, "divergence" + DIFFERENCE)
    if lacks := _missing(trials, metric):
        return Sheet("S12", (), (("it", lacks),))
    names, medians = participant_medians(trials, metric)
    groups = participant_groups(medians)
    parts = {"all": trials}
    if groups.groups == 2:
        is_softer = np.isin(trials.participant, names[groups.membership > 0.5])
        parts = {"stiffer skin": _select_trials(trials, ~is_softer), "softer skin": _select_trials(trials, is_softer)}
    panels = [SheetPanel.single("A", draw_groups, medians, groups, f"median {metric_label(metric)}")]
    panels += [
        SheetPanel.single(f"B, {name}" if len(parts) > 1 else "B", trial_metrics.draw_share_against, part, metric)
        for name, part in parts.items()
    ]
    left_out = [("A", f"two groups: {groups.reason}")] if groups.reason else []
    if not np.issubdtype(trials.condition.dtype, np.number):
        held = f"the vibration amplitude (µm) in the column condition, not {str(trials.condition[0])!r}"
        left_out.append(("C", held))
    elif np.unique(trials.condition).size < _FEWEST_AMPLITUDES:
        left_out.append(("C", f"{_FEWEST_AMPLITUDES} amplitudes in the column condition or more"))
    else:
        panels.append(SheetPanel.single("C", _draw_curves, parts, GUESSES[design]))
    return Sheet("S12", tuple(panels), tuple(left_out), "performance of participants")


def _draw_curves(axes: Axes, parts: dict[str, Trials], guess: float | None) -> None:
    curves = {}
    for name, trials in parts.items():
        stimulus = trials.condition.astype(np.float64)
        table = pd.DataFrame({"who": trials.participant, "stimulus": stimulus, "answer": trials.answer})
        blocks = table.groupby(["who", "stimulus"])["answer"].agg(["sum", "count"]).reset_index()
        fit = fit_psychometric(blocks["stimulus"], blocks["sum"], blocks["count"], blocks["who"], guess)
        whole = blocks.groupby("stimulus")[["sum", "count"]].sum()
        curves[name] = (whole.index, whole["sum"], whole["count"], fit)
    draw_psychometric(axes, curves, AMPLITUDE)


def _select_trials(trials: Trials, chosen: NDArray[np.bool_]) -> Trials:
    columns = {name: getattr(trials, name)[chosen] for name in COLUMNS}
    return replace(trials, **columns, metrics={name: values[chosen] for name, values in trials.metrics.items()})


def _measured_name(trials: Trials, metric: str) -> str:
    """Return a metric's name, or without `_difference` where the difference has no values."""
    return metric.removesuffix(DIFFERENCE) if _missing(trials, metric) else metric


def _missing(trials: Trials, *metrics: str) -> str:
    """Return text that names the metrics that have no values in the table of trials; "" if all have some."""
    values = trials.metrics
    missing = [name for name in metrics if name not in values or not np.isfinite(values[name]).any()]
    return f"values of {', '.join(missing)} in the table of trials" if missing else ""
