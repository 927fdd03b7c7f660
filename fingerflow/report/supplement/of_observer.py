"""Figures S11, S12 and S13: the ideal observer, groups of participants and the curl, from the table of trials."""

from dataclasses import replace

import numpy as np
from matplotlib.figure import SubFigure
from numpy.typing import NDArray

from fingerflow.models.observer import (
    GUESSES,
    Trials,
    fit_psychometric,
    leave_out_moved,
    observe,
    participant_groups,
    pearson,
)
from fingerflow.report.observer import (
    draw_counts,
    draw_curl_against_divergence,
    draw_estimates,
    draw_groups,
    draw_median_curl,
    draw_psychometric,
    draw_roc,
)
from fingerflow.report.press_field import draw_curl_map
from fingerflow.report.supplement.sheet import Sheet, SheetPanel
from fingerflow.report.supplement.sources import NO_TRIALS, Sources
from fingerflow.report.trial_metrics import AMPLITUDE, draw_share_against, label_of, shown_values

_OBSERVED = (
    "divergence", "force_angle", "global_displacement", "strain_rate", "strain_energy", "force_rate",
    "real_contact_area",
)  # fmt: skip
_FEWEST_AMPLITUDES = 3


def ideal_observer(sources: Sources) -> Sheet:
    """Figure S11, of the metrics that the paper tests and the table has, without trials of fingers that slid."""
    trials = sources.trials
    metrics = [name for name in _OBSERVED if not sources.lacks(name)]
    missing = [name for name in _OBSERVED if name not in metrics]
    if trials is None or not metrics:
        return Sheet("S11", (), (f"needs {NO_TRIALS} with {', '.join(_OBSERVED)}",))
    if "global_displacement" in trials.metrics:
        trials = leave_out_moved(trials)
    found = observe(trials, metrics)
    named = {name.replace("_", " "): of for name, of in found.items()}
    first = next(iter(named))
    panels = (
        SheetPanel("A", lambda part: draw_counts(part.subplots(), named[first].printed, first)),
        SheetPanel(
            "B", lambda part: draw_roc(part.subplots(), {name: of.printed for name, of in named.items()}), columns=2
        ),
        SheetPanel(
            "C, d'",
            lambda part: draw_estimates(part.subplots(), {name: of.d_prime for name, of in named.items()}, "d'", 0),
        ),
        SheetPanel(
            "C, AUC",
            lambda part: draw_estimates(
                part.subplots(), {name: of.auc for name, of in named.items()}, "area under the ROC", 0.5
            ),
        ),
    )
    left_out = (f"the metrics need {sources.lacks(*missing)}",) if missing else ()
    return Sheet("S11", panels, left_out)


def individual_performance(sources: Sources) -> Sheet:
    """Figure S12: groups by each participant's median divergence, or its difference, and how they answer."""
    metric = sources.difference("divergence")
    trials, lacks = sources.trials, sources.lacks(metric)
    if trials is None or lacks:
        return Sheet("S12", (), (f"needs {lacks}",))
    divergence = trials.metrics[metric]
    names = np.unique(trials.participant)
    medians = np.array([_median(divergence[trials.participant == name]) for name in names])
    groups = participant_groups(shown_values(metric, medians))
    if groups.groups == 2:
        softer = names[groups.membership > 0.5]
        is_softer = np.isin(trials.participant, softer)
        parts = {"stiffer skin": _of(trials, ~is_softer), "softer skin": _of(trials, is_softer)}
    else:
        parts = {"all": trials}
    panels = [
        SheetPanel(
            "A",
            lambda part: draw_groups(
                part.subplots(), shown_values(metric, medians), groups, f"median {label_of(metric)}"
            ),
        )
    ]
    panels += [_scatter(f"B, {name}" if len(parts) > 1 else "B", own, metric) for name, own in parts.items()]
    left_out = [] if not groups.reason else [f"A has no groups: {groups.reason}"]
    if not np.issubdtype(trials.condition.dtype, np.number):
        left_out.append(
            f"C needs the vibration amplitude (µm) in the column condition, not {str(trials.condition[0])!r}"
        )
    elif np.unique(trials.condition).size < _FEWEST_AMPLITUDES:
        left_out.append(f"C needs {_FEWEST_AMPLITUDES} amplitudes in the column condition or more")
    else:
        panels.append(SheetPanel("C", lambda part: _draw_curves(part, parts, GUESSES[sources.design])))
    return Sheet("S12", tuple(panels), tuple(left_out))


def curl(sources: Sources) -> Sheet:
    """Figure S13; A and B of the simulated press."""
    trials = sources.trials
    panels = [
        SheetPanel("A (simulated press)", lambda part: draw_curl_map(part, sources.field)),
        SheetPanel(
            "B (simulated press)",
            lambda part: draw_median_curl(part.subplots(), [sources.field.force], [sources.field.median_curl]),
        ),
    ]
    lacks = sources.lacks("divergence", "curl")
    if trials is None or lacks:
        return Sheet("S13", tuple(panels), (f"C needs {lacks}",))
    both = trials.metrics["divergence"], trials.metrics["curl"]
    panels.append(
        SheetPanel(
            "C",
            lambda part: draw_curl_against_divergence(
                part.subplots(), *both, trials.participant, pearson(*both, participants=trials.participant)
            ),
        )
    )
    return Sheet("S13", tuple(panels))


def _scatter(letter: str, trials: Trials, metric: str) -> SheetPanel:
    return SheetPanel(letter, lambda part: draw_share_against(part.subplots(), trials, metric))


def _draw_curves(part: SubFigure, parts: dict[str, Trials], guess: float | None) -> None:
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
    draw_psychometric(part.subplots(), curves, AMPLITUDE)


def _of(trials: Trials, chosen: NDArray[np.bool_]) -> Trials:
    return replace(
        trials,
        participant=trials.participant[chosen],
        trial=trials.trial[chosen],
        condition=trials.condition[chosen],
        answer=trials.answer[chosen],
        metrics={name: values[chosen] for name, values in trials.metrics.items()},
    )


def _median(values: NDArray[np.float64]) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan
