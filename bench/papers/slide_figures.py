"""Figures 1 and 2 of Terekhov & Hayward 2011, drawn from the simulated slides."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from bench.papers.drawn import Drawn, PrintedFigure
from bench.papers.slides import ABRUPT, FADING, JudgedSlide, Slides
from fingerflow import plot
from fingerflow.models.partial_slip import CurveComparison, compare_curves, critical_load_ratio
from fingerflow.models.partial_slip.comparison import COULOMB
from fingerflow.models.partial_slip.curve_families import EQUAL_FRICTION, PARTIAL_SLIP, TADA
from fingerflow.models.partial_slip.verdict import CORRIDOR
from fingerflow.plot.axes_style import GREEN, GREY, INK, RED, YELLOW, finished, new_figure
from fingerflow.plot.outlines import matrix_of_view, to_pixels
from fingerflow.report.slip_figures import AREA, LOAD, draw_partial_slip

Values = NDArray[np.float64]
_ARROWS = 400
_ARROW_SCALE = 2
_STYLES: dict[str, dict[str, Any]] = {
    COULOMB: {"color": GREY, "linestyle": "--"},
    EQUAL_FRICTION.name: {"color": GREEN, "linestyle": "-."},
    TADA.name: {"color": GREY, "linestyle": "-"},
    PARTIAL_SLIP.name: {"color": INK, "linestyle": "-"},
}
_MARKS = ("o", "s", "^", "D")


def _picture(slides: Slides) -> Drawn:
    one = slides.of(ABRUPT)[0]
    result = one.trial.result
    frame = max(one.trial.verdict.collapse_frame, 1)
    figure = new_figure(1.06)
    axes = plot.picture(result, one.scene, frame, figure.subplots(), "contact")
    matrix = matrix_of_view(result, "contact")
    position = np.asarray(result["position"])
    known = np.flatnonzero(np.isfinite(position[[0, frame]]).all((0, 2)))
    shown = known[:: max(1, len(known) // _ARROWS)]
    tails, tips = (to_pixels(position[at, shown], matrix) for at in (0, frame))
    axes.quiver(
        *tails.T, *(tips - tails).T, angles="xy", scale_units="xy", scale=1 / _ARROW_SCALE, color=RED, width=0.003
    )
    stuck = float(result["stuck_ratio"][frame])
    return figure, (
        f"The contact view just before the collapse, with the displacement since the first frame as arrows at scale "
        f"{_ARROW_SCALE} ({len(shown)} of {len(known)} points) and the outlines of contact and stick region; "
        f"d² {stuck:.2f}, true {one.truth.stuck_share(frame):.2f}."
    )


def _models(_: Slides) -> Drawn:
    figure = new_figure(0.85)
    axes = figure.subplots()
    load: Values = 1 - np.linspace(1, 0, 400) ** 3
    axes.plot([0, 1, 1], [1, 1, 0], label=COULOMB, **_STYLES[COULOMB])
    axes.plot(load, (1 - load) ** (2 / 3), label="standard, Tada et al. 2006", **_STYLES[TADA.name])
    axes.plot(load, 1 - load, color=GREY, linestyle=":", label="μk = μs, as printed")
    for ratio, width in ((1.0, 1.0), (0.8, 1.6), (0.5, 2.2)):
        static = 1 / float(critical_load_ratio(1.0, ratio))  # puts the largest load ratio at 1
        draw_partial_slip(axes, static, ratio * static, f"equation 5, μk/μs = {ratio:g}", width)
    axes.set(xlabel=f"{LOAD} over its largest value", ylabel=AREA, xlim=(0, 1.1), ylim=(-0.03, 1.05))
    finished(axes)
    return figure, (
        "d² against T/N over its largest value, from the models alone. Dots: critical area, from which the rest "
        "slips at once. The printed line for equal friction is not that of equation 5 (A19)."
    )


def _draw_set(own: list[JudgedSlide], about: str) -> Drawn:
    """Draw the measured stuck area of a set of slides against load ratio, relative to that at full slip, with four
    models fitted to all slides; return figure and caption.
    """
    judged = [one for one in own if one.trial.verdict.loss_load_ratio > 0]
    if not judged:
        return None, "no slide of this set has a complete loss of adhesion"
    figure = new_figure(0.85)
    axes = figure.subplots()
    axes.axvspan(1 - CORRIDOR, 1 + CORRIDOR, color=YELLOW, alpha=0.2, linewidth=0, label="± 5 %")
    loading, best = [], []
    for one, mark in zip(judged, _MARKS, strict=False):
        verdict = one.trial.verdict
        area = np.asarray(one.trial.result["stuck_ratio"], dtype=float)
        load = one.trial.load_ratio() / verdict.loss_load_ratio
        before = slice(0, verdict.loss_frame + 1)
        name: str | None = verdict.outcome if one is judged[0] else None
        if verdict.outcome == "vanishes abruptly":
            collapse = slice(verdict.collapse_frame, verdict.loss_frame + 1)
            axes.plot(load[collapse], area[collapse], color=RED, linewidth=3, alpha=0.35)
            name = f"{verdict.collapse_ms:.0f} ms"
        axes.plot(
            load[before], area[before], color=RED, linewidth=0.7, marker=mark, markersize=2.5, markevery=4,
            label=name,
        )  # fmt: skip
        loading.append((area[verdict.loading()], load[verdict.loading()]))
        best.append(compare_curves(*loading[-1]).best)
    found = compare_curves(*(np.concatenate(parts) for parts in zip(*loading, strict=True)))
    _draw_models(axes, found)
    axes.set(xlabel="T/N over its value at the loss of adhesion", ylabel=AREA, xlim=(0, 1.12), ylim=(-0.03, 1.05))
    counts = ", ".join(f"{name} for {best.count(name)}" for name in dict.fromkeys(best))
    finished(axes)
    return figure, (
        f"d² against T/N of {len(judged)} slides, and four models fitted to all of them before the loss. {about} "
        f"Fitted to each slide, the best by AICc is {counts}."
    )


def _draw_models(axes: Axes, found: CurveComparison) -> None:
    area: Values = np.linspace(0, 1, 300)
    for name, score in found.scores.items():
        values = list(score.coefficients.values())
        if name == COULOMB:
            axes.plot([0, values[0], values[0]], [1, 1, 0], label=name, **_STYLES[name])
        elif name == PARTIAL_SLIP.name:
            draw_partial_slip(axes, values[0], max(values[1], 0.0), "equation 5", 1.4)
        else:
            family = TADA if name == TADA.name else EQUAL_FRICTION
            axes.plot(family.load(area)[:, 0] * values[0], area, label=name, **_STYLES[name])


def _over_time(slides: Slides) -> Drawn:
    figure = new_figure(0.85)
    axes = figure.subplots()
    for kind, colour, style in ((ABRUPT, RED, "-"), (FADING, INK, "--")):
        one = slides.of(kind)[0]
        time, verdict = np.asarray(one.trial.result["time"]), one.trial.verdict
        since = time - time[verdict.loss_frame]
        truth = [one.truth.stuck_share(frame) for frame in range(len(time))]
        axes.plot(since, truth, color=GREY, linewidth=3, alpha=0.5, label="truth" if kind == ABRUPT else None)
        axes.plot(since, one.trial.result["stuck_ratio"], color=colour, linestyle=style, label=verdict.outcome)
    axes.set(xlabel="time since the loss of adhesion (s)", ylabel=AREA, ylim=(-0.03, 1.05), xlim=(-1.7, 0.4))
    finished(axes)
    return figure, "d² against time, a slide of each category, with the simulated d² in grey."


FIGURES: tuple[PrintedFigure[Slides], ...] = (
    PrintedFigure("1", "finger image with flow arrows; dashed contours of contact and stuck region", _picture),
    PrintedFigure("2a", "d² against T/N; standard model grey, new model black, Coulomb dashed", _models),
    PrintedFigure("2b", "four measured d² curves ending abruptly; thicker grey: loss phase, duration", lambda slides:
                  _draw_set(slides.of(ABRUPT), "The thick lines are the fitted collapse, with its duration.")),
    PrintedFigure("2c", "four measured d² curves shrinking without critical size", lambda slides:
                  _draw_set(slides.of(FADING), "The area fades without a collapse.")),
    PrintedFigure("2d", "d² against time, one trial of each category", _over_time),
)  # fmt: skip
