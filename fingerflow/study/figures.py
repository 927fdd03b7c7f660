"""Figures of a study: those of the paper's supplement that the table of trials supports, and curves against force."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes

from fingerflow.models.observer import FORCED_CHOICE
from fingerflow.plot.axes_style import finished
from fingerflow.report.supplement import FIGURES, Sheet, SheetPanel, Sources
from fingerflow.report.trial_metrics import AMPLITUDE, finished_beside
from fingerflow.schema.trial_columns import NUMBERS
from fingerflow.study.statistics import Sample

_FIGURES = ("S1", "S5", "S7", "S8", "S9", "S11", "S12", "S13")
_SIMULATED = ("(skin chain)", "(simulated press)")  # panels that do not depend on the study
# Panels against answers, omitted in a study without answers; None for the whole figure.
_OF_ANSWERS: dict[str, str | None] = {"S5": "EFGI", "S7": "CDE", "S8": "HI", "S9": "E", "S11": None, "S12": None}
# Panels that the paper draws against force: the averaged curves, by figure and letter.
_CURVES = {
    "S1": (("C", "gross_contact_area"), ("E", "real_contact_area")),
    "S8": (("E (along)", "strain"),),
    "S9": (("B", "strain_energy"),),
    "S13": (("B", "curl"),),
}
_AREAS = ("gross_contact_area", "real_contact_area")  # of figure S1, which shows them at 3 N
_MOST_NAMED = 12  # most conditions in a legend


def write_figures(
    frame: Any, sample: Sample, curves: Any, folder: Path, design: str = FORCED_CHOICE
) -> list[tuple[str, str, tuple[str, ...]]]:
    """Write the figures of a study as PNG; return name, file ("" if not drawn) and omissions of each.

    Args:
        frame: the table of trials.
        sample: of it.
        curves: the table of averaged curves.
        folder: created if missing.
        design: of the experiment, a name in `GUESSES`.

    Raises FingerflowError if a file cannot be written.
    """
    written = []
    for name in _FIGURES:
        trials = sample.trials
        if name == "S1":
            own = frame.set_index(["participant", "trial", "condition"])
            places = list(zip(trials.participant, trials.trial, trials.condition, strict=True))
            at_3n = {
                area: own.loc[places, f"{area}_at_3n"].to_numpy(float) for area in _AREAS if f"{area}_at_3n" in own
            }
            trials = replace(trials, metrics={**trials.metrics, **at_3n})
        sheet = FIGURES[name](Sources(trials=trials, design=design))
        of_answers = _OF_ANSWERS.get(name, "")
        dropped = [] if sample.answered or of_answers == "" else [of_answers or "all"]
        panels = [
            replace(panel, letter=f"{panel.letter}, at 3 N") if name == "S1" else panel
            for panel in sheet.panels
            if not panel.letter.endswith(_SIMULATED)
            and (sample.answered or (of_answers is not None and panel.letter not in of_answers))
        ]
        drawn = {letter: metric for letter, metric in _CURVES.get(name, ()) if (curves["metric"] == metric).any()}
        panels += [_curve_panel(letter, curves, metric) for letter, metric in drawn.items()]
        left_out = [said for said in sheet.left_out if not _about(said, drawn)]
        left_out += [f"{', '.join(letters)} need answers" for letters in dropped]
        path = Sheet(name, tuple(sorted(panels, key=lambda panel: panel.letter))).write(folder) if panels else None
        written.append((name, "" if path is None else path.name, tuple(left_out)))
    return written


def draw_curves(axes: Axes, curves: Any, metric: str) -> Axes:
    """Draw the mean curve of a metric against normal force for each condition, with a 95 % band over participants."""
    own = curves[curves["metric"] == metric]
    conditions = list(dict.fromkeys(own["condition"]))
    shown = NUMBERS[metric]
    # The range of the axis follows the means: an interval of two participants is many times wider.
    means = shown.shown_values(own["mean"])
    margin = 0.6 * max(float(means.max() - means.min()), 1e-12)
    for condition, colour in zip(conditions, colormaps["viridis"](np.linspace(0, 0.9, len(conditions))), strict=True):
        part = own[own["condition"] == condition]
        force, mean = part["normal_force_N"], shown.shown_values(part["mean"])
        axes.plot(force, mean, color=colour, label=_named(condition) if len(conditions) <= _MOST_NAMED else None)
        low, high = shown.shown_values(part["low"]), shown.shown_values(part["high"])
        axes.fill_between(force, low, high, color=colour, alpha=0.15, linewidth=0)
    low, high = axes.get_ylim()
    axes.set(xlabel="normal force (N)", ylabel=shown.axis_label)
    axes.set_ylim(max(low, float(means.min()) - margin), min(high, float(means.max()) + margin))
    return finished_beside(axes, AMPLITUDE) if axes.get_legend_handles_labels()[0] else finished(axes)


def _named(condition: object) -> str:
    return f"{condition:g}" if isinstance(condition, float) else str(condition)


def _curve_panel(letter: str, curves: Any, metric: str) -> SheetPanel:
    return SheetPanel(letter, lambda part: draw_curves(part.subplots(), curves, metric))


def _about(said: str, drawn: Mapping[str, str]) -> bool:
    """Return True if all panels that a sentence calls missing are drawn as curves of the study instead."""
    letters = {part.strip() for part in said.partition(" need")[0].split(",")}
    return bool(letters) and letters <= {letter[0] for letter in drawn}
