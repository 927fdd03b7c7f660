"""Figures of Terekhov & Hayward 2011: skin motion, and the relative stuck area against load ratio and time."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from numpy.typing import ArrayLike, NDArray

from fingerflow.models.partial_slip import (
    FrictionFit,
    TrialVerdict,
    critical_load_ratio,
    critical_stuck_area,
    stuck_area,
)
from fingerflow.models.partial_slip.verdict import CORRIDOR
from fingerflow.plot.axes_style import GREY, INK, RED, YELLOW, finished, line_styles
from fingerflow.plot.captions import describe
from fingerflow.plot.outlines import contact_outline, stuck_outline
from fingerflow.schema.rounding import format_uncertainty

LOAD, AREA = "T/N", "stuck area / contact area, d²"
PRINTED = "moved by less than 40 µm"
_STUCK = ("stuck_ratio", "stuck_ratio_std", "printed_stuck_ratio")


def draw_motion(axes: Axes, result: xr.Dataset, frame: int) -> Axes:
    """Draw figure 1: displacement of the skin since the first frame as arrows in true length, with outlines of contact
    and stick region; `frame` is an index in the result.
    """
    position, shown = result["position"].values.astype(np.float64), result.isel(frame=frame)
    moved = position[frame] - position[0]
    known = np.isfinite(moved).all(1)
    axes.quiver(
        *position[0][known].T, *moved[known].T, angles="xy", scale_units="xy", scale=1, color=INK, width=0.003, zorder=2
    )
    outlines = (contact_outline(shown), INK, "--", "contact"), (stuck_outline(shown), RED, "-", "stuck")
    for outline, colour, dashes, name in outlines:
        if outline is not None:
            ring = np.append(outline, outline[:1], 0)
            axes.plot(*ring.T, color=colour, linestyle=dashes, linewidth=1.4, label=name)
    axes.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    if not axes.yaxis_inverted():
        axes.invert_yaxis()
    axes.grid(alpha=0.25)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1), ncols=2)
    describe(
        axes,
        "Displacement of the skin as arrows at scale 1, with the outlines of the gross contact and of the stick "
        f"region. n = {int(known.sum())} points.",
    )
    return axes


def draw_trial(
    axes: Axes,
    stuck_area: ArrayLike,
    load_ratio: ArrayLike,
    verdict: TrialVerdict,
    fit: FrictionFit | None = None,
    printed_area: ArrayLike | None = None,
) -> Axes:
    """Draw figures 2 b and c for one trial: the stuck area relative to the contact area, d^2, against the load ratio
    (tangential over normal force), with the verdict on slip and the fitted friction model.

    ``printed_area`` is the d^2 of the printed criterion, drawn beside it.
    """
    area, load = np.asarray(stuck_area, dtype=float), np.asarray(load_ratio, dtype=float)
    axes.plot(load, area, ".", markersize=3, color=GREY, label="not slipped")
    if printed_area is not None:
        axes.plot(load, np.asarray(printed_area, dtype=float), "x", markersize=3, color=YELLOW, label=PRINTED)
    if np.isfinite(verdict.loss_load_ratio):
        edges = verdict.loss_load_ratio * (1 - CORRIDOR), verdict.loss_load_ratio * (1 + CORRIDOR)
        axes.axvspan(*edges, color=YELLOW, alpha=0.25, linewidth=0, label="± 5 %")
    collapses = _draw_collapse(axes, load, area, verdict)
    if collapses:
        axes.axhline(verdict.critical_area, color=RED, linewidth=0.8, linestyle=":")
        low, high = (verdict.critical_area + sign * verdict.critical_area_std for sign in (-1, 1))
        axes.axhspan(low, high, color=RED, alpha=0.1, linewidth=0)
    if fit is not None and fit.identified:
        draw_partial_slip(axes, fit.mu_s, max(fit.mu_k, 0.0), rf"$\mu_s$ = {fit.mu_s:.2f}, $\mu_k$ = {fit.mu_k:.2f}")
    axes.set(xlabel=LOAD, ylabel=AREA, ylim=(-0.03, 1.05), title=verdict.outcome)
    measured = int((np.isfinite(area) & np.isfinite(load)).sum())
    caption = [
        "Stuck area over contact area, d², against the friction ratio T/N, tangential over normal force; yellow: "
        f"T/N within {100 * CORRIDOR:g} % of its value at the complete loss of adhesion."
    ]
    if printed_area is not None:
        caption.append("Crosses: d² by the printed criterion, displacement below 40 µm.")
    if collapses:
        critical = format_uncertainty(verdict.critical_area, verdict.critical_area_std)
        caption.append(f"Dotted, with a band of ± one standard deviation: critical d² {critical}. Thick: its collapse.")
    return finished(axes, " ".join([*caption, f"n = {measured} frames."]))


def draw_trials(axes: Axes, trials: Sequence[tuple[ArrayLike, ArrayLike, TrialVerdict]]) -> Axes:
    """Draw figures 2 b and c for many trials, each given as (d^2, load ratio, verdict): the stuck area relative to the
    contact area, d^2, against the load ratio over its value at full slip.

    Trials without a complete loss of adhesion are counted, not drawn.
    """
    styles = dict(zip(("diminishes", "vanishes abruptly", "inconclusive"), line_styles(3), strict=True))
    axes.axvspan(1 - CORRIDOR, 1 + CORRIDOR, color=YELLOW, alpha=0.25, linewidth=0, label="± 5 %")
    for area, load, verdict in trials:
        if verdict.loss_load_ratio > 0:
            shown = slice(0, verdict.loss_frame + 1)
            scaled = np.asarray(load, dtype=float)[shown] / verdict.loss_load_ratio
            axes.plot(scaled, np.asarray(area, dtype=float)[shown], linewidth=0.8, **styles[verdict.outcome])
    for outcome, style in styles.items():
        count = sum(verdict.outcome == outcome for *_, verdict in trials)
        axes.plot([], [], label=f"{outcome}: {count}", **style)
    axes.set(xlabel="T/N over its value at the loss of adhesion", ylabel=AREA, ylim=(-0.03, 1.05), xlim=(0, 1.15))
    drawn = sum(verdict.loss_load_ratio > 0 for *_, verdict in trials)
    return finished(
        axes,
        "Stuck area over contact area, d², of each trial until its complete loss of adhesion, against the friction "
        f"ratio T/N relative to that at the loss; yellow: within {100 * CORRIDOR:g} % of it. n = {len(trials)} trials, "
        f"{drawn} of them with a complete loss.",
    )


def draw_over_time(axes: Axes, result: xr.Dataset, verdict: TrialVerdict) -> Axes:
    """Draw figure 2 d: the stuck area relative to the contact area, d^2, against time (s), with the collapse and the
    start of full slip that `verdict` states, a band of one standard deviation, and d^2 by the printed criterion.
    """
    series = {name: np.asarray(result[name], dtype=float) for name in ("time", *_STUCK) if name in result}
    when, area, spread = series["time"], series["stuck_ratio"], series.get("stuck_ratio_std")
    axes.plot(when, area, color=INK, linewidth=1, label="not slipped")
    if spread is not None and np.isfinite(spread).any():
        axes.fill_between(when, area - spread, area + spread, color=INK, alpha=0.15, linewidth=0, label="± 1 deviation")
    if "printed_stuck_ratio" in series:
        axes.plot(when, series["printed_stuck_ratio"], "--", color=YELLOW, linewidth=1, label=PRINTED)
    collapses = _draw_collapse(axes, when, area, verdict)
    if verdict.loss_frame >= 0:
        axes.axvline(when[verdict.loss_frame], color=GREY, linestyle="--", label="complete loss")
    axes.set(xlabel="time (s)", ylabel=AREA, ylim=(-0.03, 1.05), title=verdict.outcome)
    collapse = format_uncertainty(verdict.collapse_ms, verdict.collapse_ms_std)
    lasts = f" Thick: the collapse, {collapse} ms (± one standard deviation)." if collapses else ""
    return finished(axes, f"d² against time.{lasts} n = {int(np.isfinite(area).sum())} frames.")


def _draw_collapse(axes: Axes, x: NDArray[Any], area: NDArray[Any], verdict: TrialVerdict) -> bool:
    """Draw as a thick line the part of the curve of `area` against `x` in which the stuck area suddenly collapses, and
    return True; if the verdict states no collapse, draw nothing and return False.
    """
    if verdict.outcome != "vanishes abruptly":
        return False
    collapse = slice(verdict.collapse_frame, verdict.loss_frame + 1)
    name = f"collapse, {format_uncertainty(verdict.collapse_ms, verdict.collapse_ms_std)} ms"
    axes.plot(x[collapse], area[collapse], color=RED, linewidth=3, alpha=0.7, label=name)
    return True


def draw_partial_slip(axes: Axes, mu_s: float, mu_k: float, name: str, width: float | None = None) -> None:
    """Draw the stuck area that the partial-slip model predicts against the load ratio, with the critical area as a dot;
    `width` is that of the line in points.
    """
    # Space the loads quadratically: near the critical load the area changes too fast for equal steps.
    smallest = float(critical_stuck_area(mu_s, mu_k).nan_to_num(0.0))
    largest = float(critical_load_ratio(mu_s, mu_k))
    load = largest * (1 - np.linspace(1, 0, 400) ** 2)
    axes.plot(load, stuck_area(load, mu_s, mu_k), color=INK, linewidth=width, label=name)
    if smallest > 0:
        axes.plot([largest, largest], [smallest, 0], ":", color=INK)
        axes.plot(largest, smallest, "o", color=INK, markersize=4)
