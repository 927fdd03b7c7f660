"""Metrics of many trials, as in figures S1, S5 and S7 to S9 and S13 of Willemet et al. 2021, drawn into given axes.

An answer is correct if the vibrating comparison was felt as more slippery than the reference, which does not vibrate.
"""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.transforms import offset_copy
from numpy.typing import NDArray
from scipy import stats

from fingerflow.errors import FingerflowError
from fingerflow.models.observer import Anova, Trials, pearson, repeated_anova, share_above, spearman
from fingerflow.plot.axes_style import GREY, INK, RED, dot_styles, finished, line_styles, named_lines
from fingerflow.plot.captions import definition_text, sentence
from fingerflow.schema.rounding import format_interval, format_uncertainty
from fingerflow.schema.trial_columns import DIFFERENCE, NUMBERS

Values = NDArray[np.float64]
ANSWERED = "p(more slippery)"
AMPLITUDE = "vibration amplitude (µm)"
_BINS = 8  # number of bins with equally many trials
_LONG_TAIL = 10  # largest value over the median, above which an axis has a scale that is linear up to the median only
_APART = 6.0  # pt over which dots of one share are drawn in rows, an amplitude a row
_HATCHES = ("", "////", "....")  # hatches of bars, which distinguish these without colour

#: Metrics that figures and statistics use, columns of the table of trials.
METRICS = (
    "max_force", "time_to_max_force", "duration", "force_rate", "max_displacement", "global_displacement",
    "force_angle", "real_contact_area", "gross_contact_area", "divergence", "curl", "strain", "strain_rate",
    "strain_energy", "strain_energy_rate",
)  # fmt: skip


def metric_label(metric: str) -> str:
    """Return the axis label of a metric; `_difference` in its name stands for comparison minus reference."""
    column = NUMBERS[metric.removesuffix(DIFFERENCE)]
    return column.shown_unit.heading(f"{column.words} difference" if metric.endswith(DIFFERENCE) else column.words)


def _defined(metric: str) -> str:
    less = ", comparison less reference" if metric.endswith(DIFFERENCE) else ""
    return definition_text(NUMBERS[metric.removesuffix(DIFFERENCE)], less)


def draw_distribution(axes: Axes, trials: Trials, metric: str) -> Axes:
    """Draw figures S5 B, C, D and H: histogram of a metric with its mean and standard deviation."""
    values = _shown(trials, metric)
    finite = values[np.isfinite(values)]
    axes.hist(finite, bins=max(8, min(40, round(finite.size**0.5))), color=GREY, alpha=0.7)
    if finite.size > 1:
        mean, deviation = finite.mean(), finite.std(ddof=1)
        axes.axvline(mean, color=INK)
        axes.axvspan(mean - deviation, mean + deviation, color=INK, alpha=0.12, linewidth=0)
        axes.set_title(f"{format_uncertainty(mean, deviation)}, {finite.size} trials")
    axes.set(xlabel=metric_label(metric), ylabel="trials")
    return finished(
        axes,
        f"Histogram. {_defined(metric)} Line and band: mean ± one standard deviation over trials. "
        f"n = {finite.size} trials.",
    )


def draw_influence(axes: Axes, trials: Trials, metric: str) -> Axes:
    """Draw figures S5 E, F and G: share of "more slippery" answers in eight bins of a metric, with an ANOVA.

    Participants are the units of the intervals and a random effect of the ANOVA.
    """
    values = _shown(trials, metric)
    finite = np.isfinite(values)
    if finite.any():
        edges = np.unique(np.quantile(values[finite], np.linspace(0, 1, _BINS + 1)))
        which = np.clip(np.searchsorted(edges, values[finite], side="right") - 1, 0, max(len(edges) - 2, 0))
        answers = trials.answer[finite]
        groups = [which == number for number in np.unique(which)]
        shares = np.array([answers[group].mean() for group in groups])
        middles = np.array([np.median(values[finite][group]) for group in groups])
        people = trials.participant[finite]
        limits = np.array([share_above(0.5, answers[group], people[group]).interval for group in groups]).T
        axes.errorbar(middles, shares, np.abs(limits - shares), fmt="o", color=INK, markersize=4, capsize=2)
    axes.set(xlabel=metric_label(metric), ylabel=ANSWERED, ylim=(-0.05, 1.05))
    test = repeated_anova(values, trials.answer, trials.participant)
    axes.set_title(_anova_text(test))
    return finished(
        axes,
        f"Share of trials in which the comparison was felt as more slippery, in {_BINS} bins of equally many trials at "
        f"their median. {_defined(metric)} Bars: 95 % intervals, participants as units. {_anova_sentence(test)} "
        f"n = {int(finite.sum())} trials.",
    )


def draw_influence_by_condition(axes: Axes, trials: Trials, metric: str) -> Axes:
    """Draw figure S5 I: share of "more slippery" answers by vibration amplitude, for three levels of a metric."""
    values = _shown(trials, metric)
    finite = np.isfinite(values)
    conditions, condition = _conditions(trials)
    low, high = np.quantile(values[finite], (1 / 3, 2 / 3)) if finite.any() else (np.nan, np.nan)
    third = np.where(finite, (values >= low).astype(int) + (values >= high), -1)
    names = (f"< {low:.3g}", f"{low:.3g} to {high:.3g}", f"≥ {high:.3g}")
    for number, (name, style, hatch) in enumerate(zip(names, line_styles(3, True), _HATCHES, strict=True)):
        answers = [trials.answer[(third == number) & (condition == index)] for index in range(len(conditions))]
        shares = [float(group.mean()) if group.size else np.nan for group in answers]
        where = np.arange(len(conditions)) + 0.27 * (number - 1)
        axes.bar(where, shares, 0.25, label=name, color=style["color"], hatch=hatch, edgecolor="white", linewidth=0)
    axes.set(xticks=range(len(conditions)), xticklabels=conditions, xlabel=AMPLITUDE, ylabel=ANSWERED, ylim=(0, 1.05))
    size = f"{int(finite.sum())} trials of {np.unique(trials.participant[finite]).size} participants"
    return finish_with_side_legend(
        axes,
        metric_label(metric),
        "Share of trials in which the comparison was felt as more slippery, by vibration amplitude, for trials in the "
        f"low, middle and high third of the metric. {_defined(metric)} n = {size}.",
    )


def draw_by_condition(axes: Axes, trials: Trials, metric: str, normalised: bool = False) -> Axes:
    """Draw figures S1 D and F, S5 J, S7 A and B: a metric against vibration amplitude, with an ANOVA.

    Dots are the medians of the participants' trials, with their median and mean ± SD.

    Args:
        axes: axes to draw into.
        trials: table of trials.
        metric: name in METRICS, or with `_difference`.
        normalised: divide by the median of each participant, as for contact areas.
    """
    values = _shown(trials, metric)
    if normalised:
        own = pd.Series(values).groupby(trials.participant).transform("median").to_numpy()
        values = values / np.where(own > 0, own, np.nan)
    conditions, _ = _conditions(trials)
    medians, _, condition, who = participant_dots(trials, values)
    for index in np.unique(condition):
        group = medians[condition == index]
        # Spread the dots in the order of the table and not at random, so that figures are reproducible.
        axes.plot(index + np.linspace(-0.3, 0.3, group.size), group, ".", color=GREY, markersize=4, zorder=1)
        if group.size > 1:
            mean, deviation = group.mean(), group.std(ddof=1)
            axes.bar(index, 2 * deviation, 0.6, mean - deviation, color=INK, alpha=0.18, linewidth=0)
        axes.plot([index - 0.3, index + 0.3], [np.median(group)] * 2, color=INK, linewidth=2)
    test = repeated_anova(values, trials.condition, trials.participant)
    label = metric_label(metric)
    label = f"{label.partition(' (')[0]} over own median" if normalised else label
    axes.set(xticks=range(len(conditions)), xticklabels=conditions, xlabel=AMPLITUDE, ylabel=label)
    axes.set_title(_anova_text(test))
    over = f"{sentence(label)}, the median of the participant's trials."
    return finished(
        axes,
        "Dots: medians of the trials of a participant, by vibration amplitude. "
        f"{over if normalised else _defined(metric)} Line: median; bar: mean ± one standard deviation over "
        f"participants. {_anova_sentence(test)} n = {medians.size} dots of {np.unique(who).size} participants, "
        f"{int(np.isfinite(values).sum())} trials.",
    )


def draw_share_against(axes: Axes, trials: Trials, metric: str) -> Axes:
    """Draw figures S7 C to E, S8 H and I, S9 E: share of "more slippery" answers against the median of a metric, one
    dot per participant and vibration amplitude.

    One dot a participant and amplitude, darker for smaller amplitudes. The title has Spearman's coefficient over the
    dots.
    """
    values = _shown(trials, metric)
    conditions, _ = _conditions(trials)
    medians, shares, condition, who = participant_dots(trials, values)
    for index, style in enumerate(line_styles(len(conditions), ordered=True)):
        dots, label = condition == index, conditions[index] if index in named_lines(len(conditions)) else None
        (drawn,) = axes.plot(medians[dots], shares[dots], "o", color=style["color"], label=label, markersize=2.5)
        row = _APART * (index / len(conditions) - 0.5)
        drawn.set_transform(offset_copy(axes.transData, axes.get_figure(True), 0, row, "points"))
    correlation = spearman(medians, shares, participants=who)
    axes.set(xlabel=f"median {metric_label(metric)}", ylabel=ANSWERED, ylim=(-0.1, 1.1))
    middle, far = np.quantile(np.abs(medians), (0.5, 1)) if medians.size else (1, 1)
    if 0 < _LONG_TAIL * middle < far:
        axes.set_xscale("symlog", linthresh=10 ** np.round(np.log10(middle)))  # a decade, so that ticks stay apart
    else:
        axes.locator_params(axis="x", nbins=5)
    size = f"{correlation.trials} dots of {correlation.participants} participants"
    axes.set_title(f"Spearman {correlation.value:.2f}, {_p(correlation.p)}")
    return finish_with_side_legend(
        axes,
        AMPLITUDE,
        "Share of trials in which the comparison was felt as more slippery against the median of the metric, one dot a "
        "participant and amplitude, darker for smaller ones; dots of one share are drawn apart by amplitude. "
        f"{_defined(metric)} Spearman's rank correlation (95 % interval): "
        f"{format_interval(correlation.value, *correlation.interval)}, {_p(correlation.p)}; n = {size}.",
    )


def draw_correlation(axes: Axes, trials: Trials, first: str, second: str) -> Axes:
    """Draw figures S8 G and S9 D: one metric against another, coloured by participant, with a fitted line and R².

    The slope is the mean of the participants' slopes, each the median over all pairs of trials (Theil & Sen), which few
    far trials do not turn. Without an interval, as of fewer than three participants, a line would say more than the
    trials do: none is drawn.
    """
    x, y = _draw_by_participant(axes, trials, first, second)
    correlation = pearson(x, y, trials.participant)
    axes.set_title(f"no line: {correlation.reason}")
    if np.isfinite(correlation.interval).all():
        slopes, ends = participant_lines(x, y, trials.participant)[:, 0], np.nanquantile(x, (0.01, 0.99))
        slope, deviation = float(slopes.mean()), float(slopes.std(ddof=1))
        axes.plot(ends, slope * ends + np.nanmedian(y - slope * x), color=RED, linewidth=1.2)
        axes.set_title(f"slope {format_uncertainty(slope, deviation)}, R² = {correlation.value**2:.2f}")
    axes.set(xlabel=metric_label(first), ylabel=metric_label(second))
    size = f"{correlation.trials} trials of {np.unique(trials.participant).size} participants"
    return finished(
        axes,
        f"One dot a trial, one marker a participant. {_defined(first)} {_defined(second)} Slope: mean ± one standard "
        f"deviation of the participants' slopes (Theil & Sen); R² of all trials. n = {size}.",
    )


def draw_dots(axes: Axes, x: Values, y: Values, participants: NDArray[Any]) -> None:
    """Draw one dot a trial, with one colour and marker a participant; arrays (T,)."""
    names = np.unique(participants)
    for name, style in zip(names, dot_styles(names.size), strict=True):
        own = participants == name
        axes.plot(x[own], y[own], markersize=2.5, markeredgewidth=0, alpha=0.6, **style)


def participant_lines(x: Values, y: Values, participants: NDArray[Any]) -> Values:
    """Fit a line of y (T,) over x (T,) of each of P participants, by the method of Theil & Sen.

    Return the slopes and offsets (P, 2). Participants whose x does not vary are left out.
    """
    both = np.isfinite(x) & np.isfinite(y)
    parts = [both & (participants == name) for name in np.unique(participants[both])]
    return np.array([stats.theilslopes(y[part], x[part])[:2] for part in parts if np.ptp(x[part])])


def draw_medians(axes: Axes, trials: Trials, first: str, second: str) -> Axes:
    """Draw figure S13 C: one median over the contact against another, a dot a trial, coloured by participant."""
    correlation = pearson(*_draw_by_participant(axes, trials, first, second), participants=trials.participant)
    axes.set(xlabel=f"median {metric_label(first)}", ylabel=f"median {metric_label(second)}")
    axes.set_title(f"r = {format_interval(correlation.value, *correlation.interval)}, {correlation.trials} trials")
    return finished(
        axes,
        f"One dot a trial, one marker a participant. {_defined(first)} {_defined(second)} r: Pearson's "
        f"correlation with its 95 % interval, participants as units. n = {correlation.trials} trials of "
        f"{np.unique(trials.participant).size} participants.",
    )


def participant_dots(trials: Trials, values: Values) -> tuple[Values, Values, NDArray[np.intp], NDArray[Any]]:
    """Return, for N pairs of participant and condition, four arrays (N,): the median of the trials' `values`, the share
    of "more slippery" answers, the index of the condition, and the participant.

    Pairs without a known value are left out.
    """
    _, level = _conditions(trials)
    table = pd.DataFrame({"who": trials.participant, "level": level, "median": values, "share": trials.answer})
    pairs = table[np.isfinite(values)].groupby(["who", "level"], as_index=False)
    dots = pairs.agg({"median": "median", "share": "mean"})
    return dots["median"].to_numpy(), dots["share"].to_numpy(), dots["level"].to_numpy(), dots["who"].to_numpy()


def participant_medians(trials: Trials, metric: str) -> tuple[NDArray[Any], Values]:
    """Return the participants' names and the median of a metric for each, in its axis unit; NaN where unknown."""
    medians = pd.Series(_shown(trials, metric)).groupby(trials.participant).median()
    return medians.index.to_numpy(), medians.to_numpy()


def finish_with_side_legend(axes: Axes, title: str, caption: str) -> Axes:
    """Add a light grid, a caption and, to the right of the axes, a legend to axes, and return them; the legend is
    headed by the last word of `title`, its unit.
    """
    finished(axes, caption)
    axes.legend(
        frameon=False, title=title.rpartition(" ")[2], loc="center left", bbox_to_anchor=(1, 0.5), handletextpad=0.3,
        handlelength=2.4 if axes.lines and axes.lines[0].get_linestyle() != "None" else 0.8,
    )  # fmt: skip
    return axes


def _draw_by_participant(axes: Axes, trials: Trials, first: str, second: str) -> tuple[Values, Values]:
    """Draw one metric against another, coloured by participant, and return both (T,) in the units of the axes."""
    x, y = _shown(trials, first), _shown(trials, second)
    draw_dots(axes, x, y, trials.participant)
    return x, y


def _shown(trials: Trials, metric: str) -> Values:
    if metric not in trials.metrics:
        raise FingerflowError(f"the table has no metric {metric!r}: it has {', '.join(trials.metrics)}")
    return NUMBERS[metric.removesuffix(DIFFERENCE)].shown_values(trials.metrics[metric])


def _conditions(trials: Trials) -> tuple[list[str], NDArray[np.intp]]:
    """Return the names of the conditions in ascending order, and the index of its condition for each trial."""
    values, index = np.unique(trials.condition, return_inverse=True)
    return [f"{value:g}" if isinstance(value, float) else str(value) for value in values.tolist()], index


def _anova_text(test: Anova) -> str:
    """Return text on an analysis of variance: F, degrees of freedom and p-value."""
    return "no F" if np.isnan(test.f) else f"F({test.degrees[0]}, {test.degrees[1]}) = {test.f:.1f}, {_p(test.p)}"


def _anova_sentence(test: Anova) -> str:
    """Return a caption sentence that names an analysis of variance and states its outcome."""
    reason = f" ({test.reason})" if test.reason else ""
    size = f"{sum(test.trials.values())} trials of {test.participants} participants"
    return f"ANOVA with participants as a random effect: {_anova_text(test)}, {size}{reason}."


def _p(value: float) -> str:
    if np.isnan(value):
        return "no p"
    return "p < 0.001" if value < 1e-3 else f"p = {value:.3f}"
