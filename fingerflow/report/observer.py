"""Figures S11 and S12 of Willemet et al. 2021, drawn into given axes: ideal observer and groups."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from fingerflow.models.observer import Estimate, Groups, PrintedObserver, PsychometricFit
from fingerflow.models.observer.psychometric import SHARE
from fingerflow.plot.axes_style import GREEN, GREY, INK, MARKERS, RED, finished, line_styles
from fingerflow.schema.rounding import format_interval

_NAMED = 3  # largest number of ROC curves in colours


def draw_counts(axes: Axes, observer: PrintedObserver, metric: str) -> Axes:
    """Draw figure S11 A: histograms of a metric, divided by its 0.9 quantile, in correctly and in incorrectly answered
    trials, with a Gaussian fitted to each.
    """
    axes.set(xlabel=f"{metric} over its 0.9 quantile", ylabel="trials")
    if not observer.bins.size:
        axes.set_title(observer.reason)
        return finished(axes)
    middles = (observer.bins[:-1] + observer.bins[1:]) / 2
    for counts, (amplitude, mean, deviation), colour, dashes, name in (
        (observer.counts_correct, observer.correct, GREEN, "-", "correct"),
        (observer.counts_incorrect, observer.incorrect, RED, "--", "incorrect"),
    ):
        axes.stairs(counts, observer.bins, color=colour, fill=True, alpha=0.25)
        if np.isfinite(mean):
            x = np.linspace(middles[0], middles[-1], 300)
            curve = amplitude * np.exp(-(((x - mean) / deviation) ** 2) / 2)
            axes.plot(x, curve, color=colour, linestyle=dashes, label=name)
    axes.set_title(f"d' of the Gaussians {observer.d_prime:.2f}" if np.isfinite(observer.d_prime) else "no d'")
    return finished(
        axes,
        f"Trials answered correctly and incorrectly by {metric} over its 0.9 quantile, with fitted Gaussians. d': "
        "difference of their means over the root mean square of their standard deviations, negative where correct "
        f"trials have the smaller value. n = {observer.trials[0]} correct and {observer.trials[1]} incorrect trials.",
    )


def draw_roc(axes: Axes, observers: Mapping[str, PrintedObserver]) -> Axes:
    """Draw figure S11 B: ROC curves, that is hit rate against false-alarm rate for all criteria, one curve a metric."""
    axes.plot([0, 1], [0, 1], color=GREY, linewidth=0.6)
    best = sorted(observers, key=lambda name: -abs(np.nan_to_num(observers[name].auc, nan=0.5) - 0.5))
    styles = [*line_styles(_NAMED), *({"color": GREY, "linewidth": 0.6},) * len(best)]
    for k, (name, style) in enumerate(zip(best, styles, strict=False)):
        label = f"{name} ({observers[name].auc:.2f})" if k < _NAMED else "the others" if k == _NAMED else None
        axes.plot(observers[name].false_alarms, observers[name].hits, label=label, **style)
    axes.set(xlabel="p(false alarms)", ylabel="p(hits)", xlim=(0, 1), ylim=(0, 1))
    finished(
        axes,
        "Hits (correct trials above a criterion) against false alarms (incorrect trials above it) as the criterion "
        f"sweeps the metric; named: the {_NAMED} curves furthest from chance. In brackets: area under the curve, 0.5 "
        f"by chance. n = {max(sum(one.trials) for one in observers.values())} trials.",
    )
    # Beside the axes, where the legend does not cover curves.
    axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
    return axes


def draw_estimates(axes: Axes, estimates: Mapping[str, Estimate], quantity: str, chance: float) -> Axes:
    """Draw the table of figure S11 C: for each metric the estimate of `quantity` with its 95 % interval and number of
    trials, beside `chance`, the value that guessing gives.
    """
    for row, estimate in enumerate(estimates.values()):
        axes.plot(estimate.interval, [row, row], color=INK, linewidth=1.4)
        axes.plot(estimate.value, row, "o", color=INK, markersize=5)
        axes.annotate(f" n {estimate.trials}", (1, row), xycoords=("axes fraction", "data"), va="center")
    axes.axvline(chance, color=GREY, linestyle="--", linewidth=0.8)
    axes.set(yticks=range(len(estimates)), yticklabels=list(estimates), xlabel=quantity)
    axes.invert_yaxis()
    values = "; ".join(
        f"{name} {format_interval(estimate.value, *estimate.interval)}, n = {estimate.trials}"
        for name, estimate in estimates.items()
    )
    return finished(
        axes, f"Estimate of {quantity} (dot) with its 95 % interval (line), in trials; dashed: chance. {values}."
    )


def draw_groups(axes: Axes, values: ArrayLike, groups: Groups, quantity: str) -> Axes:
    """Draw figure S12 A: a histogram of a quantity's medians `values`, one per participant, with the fitted mixture of
    two Gaussians and the border between the two groups of participants.
    """
    finite = np.asarray(values, dtype=float)
    finite = finite[np.isfinite(finite)]
    _, edges, _ = axes.hist(finite, bins=max(6, round(2 * finite.size**0.5)), color=GREY, alpha=0.6)
    if groups.groups:
        two = groups.groups == 2
        means, shares = (groups.means, groups.shares) if two else ((finite.mean(),), (1.0,))
        deviation = groups.deviation if two else finite.std()
        x = np.linspace(edges[0] - 2 * deviation, edges[-1] + 2 * deviation, 300)
        for mean, share, style in zip(means, shares, line_styles(len(means)), strict=True):
            density = np.exp(-(((x - mean) / deviation) ** 2) / 2) / (deviation * (2 * np.pi) ** 0.5)
            axes.plot(x, share * density * finite.size * (edges[1] - edges[0]), **style)
        axes.axvline(groups.border if two else np.nan, color=INK, linestyle=":")
        axes.set_title(
            f"{groups.groups} group{'s' * (groups.groups > 1)}, p = {groups.p:.3f}, {groups.participants} participants"
        )
    axes.set(xlabel=quantity, ylabel="participants")
    return finished(
        axes,
        "Histogram of the participants' medians, and the Gaussian of all, or the mixture of two of one standard "
        f"deviation where it explains them better (p), with the border dotted. n = {finite.size} participants.",
    )


def draw_psychometric(
    axes: Axes, curves: Mapping[str, tuple[ArrayLike, ArrayLike, ArrayLike, PsychometricFit]], stimulus: str
) -> Axes:
    """Draw figures S12 B and C: shares of answers with the fitted psychometric curve and threshold of each group.

    Args:
        curves: (stimulus, answers, trials, fit) by name of the group, as passed to `fit_psychometric`.
        stimulus: name and unit of the stimulus.
    """
    styles = line_styles(len(curves))
    for k, (name, (where, answers, trials, fit)) in enumerate(curves.items()):
        colour = styles[k]["color"]
        x, share = np.asarray(where, dtype=float), np.asarray(answers, dtype=float) / np.asarray(trials, dtype=float)
        axes.plot(x, share, MARKERS[k], color=colour, label=f"{name}, {fit.trials} trials")
        if np.isfinite(fit.threshold):
            fine = np.linspace(x.min(), x.max(), 300)
            axes.plot(fine, fit(fine), **styles[k])
            axes.plot(np.clip(fit.interval, *axes.get_xlim()), [SHARE, SHARE], color=colour, linewidth=3, alpha=0.4)
    axes.set(xlabel=stimulus, ylabel="p(more slippery)", ylim=(-0.03, 1.03))
    thresholds = "; ".join(
        f"{name} {format_interval(fit.threshold, *fit.interval)}, n = {fit.trials} trials"
        if np.isfinite(fit.threshold)
        else f"{name} none ({fit.reason}), n = {fit.trials} trials"
        for name, (*_, fit) in curves.items()
    )
    return finished(
        axes,
        "Share of trials felt as more slippery, with fitted psychometric curves. Thick: threshold, where the curve has "
        f"the height of the line, with its 95 % interval. {thresholds}.",
    )
