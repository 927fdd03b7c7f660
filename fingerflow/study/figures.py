"""Figures of a study: those of the paper's supplement that the table of trials supports, and curves against force."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from fingerflow.models.growth_laws import power_law
from fingerflow.models.observer import FORCED_CHOICE
from fingerflow.plot import axes_style
from fingerflow.plot.captions import caption_of, sentence
from fingerflow.plot.figure_files import PNG, FigureFiles
from fingerflow.report.sheet import Sheet, SheetPanel
from fingerflow.report.supplement import FIGURES, supplement_sheet
from fingerflow.report.trial_metrics import AMPLITUDE, draw_dots, finish_with_side_legend
from fingerflow.schema.rounding import format_uncertainty
from fingerflow.schema.trial_columns import BY_SHARE, NUMBERS, UNLOADING
from fingerflow.study.statistics import Sample

# Letters of the panels that need answers, by figure. A study without answers omits them.
_OF_ANSWERS = {"S5": "EFGI", "S7": "CDE", "S8": "HI", "S9": "E", "S11": "ABC", "S12": "ABC"}
# Panels that the paper draws against force, with the metric of the averaged curve, by figure.
_CURVES = {
    "S1": (("C", "gross_contact_area"), ("E", "real_contact_area")),
    "S8": (("E (along)", "strain"),),
    "S9": (("B", "strain_energy"),),
    "S13": (("B", "curl"),),
}
_AREAS = ("gross_contact_area", "real_contact_area")  # areas in figure S1, which shows them at 3 N
_NEVER_NEGATIVE = (*_AREAS, "strain_energy", "stuck_ratio")


# Figure of a study as it was written: name, image file ("" if not drawn), caption, and sentences on the panels that
# were left out.
StudyFigure = tuple[str, str, str, list[str]]


def write_figures(
    frame: Any, sample: Sample, curves: Any, folder: Path, design: str = FORCED_CHOICE, files: FigureFiles = PNG
) -> list[StudyFigure]:
    """Draw and write the figures of a study with captions, and return the outcome for each figure.

    Args:
        frame: the table of trials.
        sample: of it.
        curves: the table of averaged curves.
        folder: created if missing.
        design: of the experiment, a name in `GUESSES`.
        files: formats and width; PNG is added where a page could show none of them.

    Raises FingerflowError if a file cannot be written.
    """
    on_page = [suffix for suffix in files.formats if suffix in ("svg", "png")] or ["png"]
    files = replace(files, formats=tuple(dict.fromkeys((*files.formats, on_page[0]))))
    sheets = [_sheet(name, sample, curves, design) for name in FIGURES]
    for metric in BY_SHARE:
        if (curves["metric"] == metric).any():
            sheets.append(Sheet(metric, (SheetPanel.single("", draw_curves, curves, metric),)))
    slid = frame[(frame["friction"] > 0) & (frame["friction_force"] > 0)]
    if len(slid):
        sheets.append(Sheet("friction", (SheetPanel.single("", draw_friction_law, slid),)))
    written: list[StudyFigure] = []
    for sheet in sheets:
        image = caption = ""
        if sheet.panels:
            default_mm = axes_style.TWO_COLUMNS_MM if sheet.name in FIGURES else axes_style.ONE_COLUMN_MM
            figure = sheet.figure(files.width_mm or default_mm)
            files.save(figure, folder, sheet.name)
            image, caption = f"{sheet.name}.{on_page[0]}", caption_of(figure)
        written.append((sheet.name, image, caption, sheet.missing()))
    return written


def _sheet(name: str, sample: Sample, curves: Any, design: str) -> Sheet:
    """Return a figure of the supplement with the panels for which the study has values, answers or averaged curves."""
    trials = sample.trials
    if name == "S1":
        at_3n = {area: f"{area}_at_3n" for area in _AREAS if f"{area}_at_3n" in sample.table}
        areas = {area: sample.table[column].to_numpy(np.float64) for area, column in at_3n.items()}
        trials = replace(trials, metrics={**trials.metrics, **areas})
    sheet = supplement_sheet(name, trials, design)
    of_answers = "" if sample.answered else _OF_ANSWERS.get(name, "")
    panels = [panel for panel in sheet.panels if panel.letter[0] not in of_answers]
    if name == "S1":
        panels = [replace(panel, letter=f"{panel.letter}, at 3 N") for panel in panels]
    for letter, metric in _CURVES.get(name, ()):
        if (curves["metric"] == metric).any():
            panels.append(SheetPanel.single(letter, draw_curves, curves, metric))
    drawn = {panel.letter[0] for panel in panels}
    left_out = [(letter, need) for letter, need in sheet.left_out if letter not in drawn]
    left_out += [(letter, "answers") for letter in of_answers]
    panels.sort(key=lambda panel: panel.letter)
    return replace(sheet, panels=tuple(panels), left_out=tuple(left_out))


def draw_friction_law(axes: Axes, slid: Any) -> Axes:
    """Draw the friction of trials against the normal force at which the finger slid, both over the geometric mean of
    the participant, with the law k N^(n - 1) of Adams et al. 2013; `slid` has these rows of the table of trials.
    """
    people = slid["participant"]
    force, friction = (
        slid[name] / np.exp(np.log(slid[name]).groupby(people).transform("mean"))
        for name in ("friction_force", "friction")
    )
    draw_dots(axes, force, friction, people)
    axes.set(xscale="log", yscale="log")
    law = power_law(force, friction, people.to_numpy())
    ends = np.array([force.min(), force.max()])
    axes.plot(ends, law.factor * ends**law.exponent, color=axes_style.RED)
    axes.set(xlabel="normal force over own mean", ylabel="friction coefficient over own mean")
    axes.set_title(f"n - 1 = {format_uncertainty(law.exponent, law.exponent_std)}")
    return axes_style.finished(
        axes,
        "Friction coefficient where no skin sticks against the median normal force there, one dot a trial, one marker "
        "a participant, with k N^(n - 1) (Adams et al. 2013): n - 1 ± one standard deviation, leaving out a "
        f"participant at a time. n = {len(slid)} trials of {people.nunique()} participants.",
    )


def draw_curves(axes: Axes, curves: Any, metric: str) -> Axes:
    """Draw the mean of a metric of the trials against normal force, or a share of the load, one curve per condition
    (vibration amplitude), with its 95 % interval over participants as a band and, with dots, its mean while the
    force falls; `curves` is the table `curves.csv` as a DataFrame.
    """
    rows, back = (curves[curves["metric"] == name] for name in (metric, f"{metric}{UNLOADING}"))
    by_share = metric in BY_SHARE
    along = "load_share" if by_share else "normal_force_N"
    by_force = "normal force over its largest" if by_share else "normal force"
    against = "T/N over that at full slip" if metric == "stuck_ratio" else by_force
    conditions, floor = list(dict.fromkeys(rows["condition"])), 0.0 if metric in _NEVER_NEGATIVE else -np.inf
    shown = (NUMBERS | BY_SHARE)[metric]
    # Let the range of the axis follow the means, as the interval of two participants is many times wider.
    means = shown.shown_values(rows["mean"])
    margin = 0.6 * max(float(means.max() - means.min()), 1e-12)
    ordered, named = axes_style.line_styles(len(conditions), ordered=True), axes_style.named_lines(len(conditions))
    dashed = dict(zip(named, axes_style.line_styles(len(named)), strict=True))
    for index, condition in enumerate(conditions):
        part, colour = rows[rows["condition"] == condition], ordered[index]["color"]
        force, mean = part[along], shown.shown_values(part["mean"])
        if index not in named:
            axes.plot(force, mean, color=colour, linewidth=0.5)
            continue
        label = f"{condition:g}" if isinstance(condition, float) else str(condition)
        axes.plot(force, mean, label=label, color=colour, linestyle=dashed[index]["linestyle"])
        low, high = shown.shown_values(part["low"]).clip(lower=floor), shown.shown_values(part["high"])
        axes.fill_between(force, low, high, color=colour, alpha=0.15, linewidth=0)
        falling = back[back["condition"] == condition]
        dots = {"color": colour, "marker": ".", "markevery": 4, "linestyle": dashed[index]["linestyle"]}
        axes.plot(falling[along], shown.shown_values(falling["mean"]), **dots)
    low, high = axes.get_ylim()
    axes.set(xlabel=against if by_share else f"{against} (N)", ylabel=shown.axis_label)
    axes.set_ylim(max(low, floor, float(means.min()) - margin), min(high, float(means.max()) + margin))
    counts = rows.groupby(along)["trials"].sum()
    evenly = counts.index.get_indexer(np.linspace(counts.index[0], counts.index[-1], 3), method="nearest")
    shown_n = counts.iloc[np.unique(evenly)]
    above = axes.secondary_xaxis("top")
    above.set_xticks(
        shown_n.index.to_list(), [f"n = {count}" if k == 0 else f"{count}" for k, count in enumerate(shown_n)]
    )
    above.tick_params(length=0, pad=1)
    caption = (
        f"{sentence(shown.words)} against {against}, by vibration amplitude: mean of the participants' means. "
        "Bands: their 95 % interval by Student's t, participants as units (low and high of curves.csv). Thin lines: "
        f"the amplitudes between those named. {'With dots: while the force falls. ' * (len(back) > 0)}"
        "Above: numbers of trials that reach a force. "
        f"n = {int(rows['participants'].max())} participants, "
        f"{int(rows.groupby('condition')['trials'].max().sum())} trials."
    )
    return finish_with_side_legend(axes, AMPLITUDE, caption)
