"""Figures S11, S12 and S13 from a table of trials: ideal observer, groups of participants, and curl."""

from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from fingerflow.models.observer import (
    GUESSES,
    Trials,
    fit_psychometric,
    leave_out_moved,
    observe,
    participant_groups,
)
from fingerflow.models.observer.trials_table import COLUMNS
from fingerflow.report.observer import draw_counts, draw_estimates, draw_groups, draw_psychometric, draw_roc
from fingerflow.report.press_field import draw_curl_map, draw_median_curl
from fingerflow.report.supplement.sheet import Sheet, SheetPanel
from fingerflow.report.supplement.sources import NO_TRIALS, Sources
from fingerflow.report.trial_metrics import (
    AMPLITUDE,
    draw_curl_against_divergence,
    draw_share_against,
    label_of,
    participant_medians,
)

#: Metrics shown in figure S11.
OBSERVED = (
    "divergence", "force_angle", "global_displacement", "strain_rate", "strain_energy", "force_rate",
    "real_contact_area",
)  # fmt: skip
_FEWEST_AMPLITUDES = 3


def ideal_observer(sources: Sources) -> Sheet:
    """Return figure S11: the ideal observer for each metric of the paper, from trials without gross slip."""
    trials = sources.trials
    metrics = [name for name in OBSERVED if not sources.missing_input(name)]
    missing = [name for name in OBSERVED if name not in metrics]
    if trials is None or not metrics:
        return Sheet("S11", (), (f"needs {NO_TRIALS} with {', '.join(OBSERVED)}",))
    if "global_displacement" in trials.metrics:
        trials = leave_out_moved(trials)
    found = {name.replace("_", " "): one for name, one in observe(trials, metrics).items()}
    printed = {name: one.printed for name, one in found.items()}
    first = next(iter(found))
    panels = (
        SheetPanel.of_axes("A", draw_counts, printed[first], first),
        SheetPanel.of_axes("B", draw_roc, printed, columns=2),
        SheetPanel.of_axes("C, d'", draw_estimates, {name: one.d_prime for name, one in found.items()}, "d'", 0),
        SheetPanel.of_axes(
            "C, AUC", draw_estimates, {name: one.auc for name, one in found.items()}, "area under the ROC", 0.5
        ),
    )
    left_out = (f"the metrics need {sources.missing_input(*missing)}",) if missing else ()
    return Sheet("S11", panels, left_out, "ideal observer of each metric")


def individual_performance(sources: Sources) -> Sheet:
    """Return figure S12: groups of participants by median divergence (or its difference), and their answers."""
    metric = sources.difference_column("divergence")
    trials, lacks = sources.trials, sources.missing_input(metric)
    if trials is None or lacks:
        return Sheet("S12", (), (f"needs {lacks}",))
    names, medians = participant_medians(trials, metric)
    groups = participant_groups(medians)
    if groups.groups == 2:
        softer = names[groups.membership > 0.5]
        is_softer = np.isin(trials.participant, softer)
        parts = {"stiffer skin": _of(trials, ~is_softer), "softer skin": _of(trials, is_softer)}
    else:
        parts = {"all": trials}
    panels = [SheetPanel.of_axes("A", draw_groups, medians, groups, f"median {label_of(metric)}")]
    panels += [
        SheetPanel.of_axes(f"B, {name}" if len(parts) > 1 else "B", draw_share_against, own, metric)
        for name, own in parts.items()
    ]
    left_out = [] if not groups.reason else [f"A has no groups: {groups.reason}"]
    if not np.issubdtype(trials.condition.dtype, np.number):
        left_out.append(
            f"C needs the vibration amplitude (µm) in the column condition, not {str(trials.condition[0])!r}"
        )
    elif np.unique(trials.condition).size < _FEWEST_AMPLITUDES:
        left_out.append(f"C needs {_FEWEST_AMPLITUDES} amplitudes in the column condition or more")
    else:
        panels.append(SheetPanel.of_axes("C", _draw_curves, parts, GUESSES[sources.design]))
    return Sheet("S12", tuple(panels), tuple(left_out), "performance of participants")


def curl(sources: Sources) -> Sheet:
    """Return figure S13: curl of the simulated press (panels A and B) and of the trials in a table (C)."""
    panels = [
        SheetPanel("A (simulated press)", lambda part: draw_curl_map(part, sources.field)),
        SheetPanel("B (simulated press)", lambda part: draw_median_curl(part.subplots(), sources.field)),
    ]
    title = "curl of the displacement"
    lacks = sources.missing_input("divergence", "curl")
    if lacks:
        return Sheet("S13", tuple(panels), (f"C needs {lacks}",), title)
    return Sheet("S13", (*panels, SheetPanel.of_axes("C", draw_curl_against_divergence, sources.trials)), title=title)


def _draw_curves(axes: Axes, parts: dict[str, Trials], guess: float | None) -> None:
    curves = {}
    for name, trials in parts.items():
        amplitudes, place = np.unique(trials.condition.astype(np.float64), return_inverse=True)
        who, person = np.unique(trials.participant, return_inverse=True)
        block = person * amplitudes.size + place
        answers, counts = (
            np.bincount(block, weights, who.size * amplitudes.size).reshape(who.size, amplitudes.size)
            for weights in (trials.answer, None)
        )
        person, place = np.nonzero(counts)
        blocks = amplitudes[place], answers[person, place], counts[person, place]
        fit = fit_psychometric(*blocks, guess=guess, participants=who[person])
        curves[name] = (amplitudes, answers.sum(0), counts.sum(0), fit)
    draw_psychometric(axes, curves, AMPLITUDE)


def _of(trials: Trials, chosen: NDArray[np.bool_]) -> Trials:
    columns = {name: getattr(trials, name)[chosen] for name in COLUMNS}
    return replace(trials, **columns, metrics={name: values[chosen] for name, values in trials.metrics.items()})
