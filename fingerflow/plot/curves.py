"""Curves of a result against time or force: areas, deformation, energy, forces, tracking quality."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.plot.abscissa import abscissa
from fingerflow.plot.axes_style import BAND, BAND_WORDS, GREY, finished, given_or_new, line_styles
from fingerflow.plot.captions import definition_text
from fingerflow.schema.variables import VARIABLES

Values = NDArray[np.float64]
_FEW = 60  # a curve with fewer frames is drawn with dots


# Curve to be drawn: legend text, values (F,) and their standard deviations (F,) or None, both in the unit of the axis,
# and the variable that it shows.
_Curve = tuple[str, Values, Values | None, str]


def contact_area(result: xr.Dataset, axes: Axes | None = None, against: str | None = None) -> Axes:
    """Draw the apparent (gross) and the real contact area.

    Args:
        result: returned by `fingerflow.process`, or a result that was opened.
        axes: axes to draw into; None for a new figure.
        against: variable of the horizontal axis; None for the normal force where it only rises or falls, else time.

    Returns:
        The axes, with a caption (`caption_of`); `FigureFiles` saves their figure. Values are in the units in which
        variables are shown (`fingerflow outputs`).

    Raises:
        FingerflowError: the result lacks a variable that is drawn.
    """
    curves = [_curve(result, "gross_contact_area", "gross")]
    if "real_contact_area" in result and np.isfinite(result["real_contact_area"].values).any():
        curves.append(_curve(result, "real_contact_area", "real"))
    return _start_at_zero(_draw(result, axes, against, curves, "Contact area", "contact area"))


def contact_axes(result: xr.Dataset, axes: Axes | None = None, against: str | None = None) -> Axes:
    """Draw the semi-axes of the ellipse of the apparent contact; arguments as for `contact_area`."""
    curves = [_curve(result, "ellipse_semi_axes", f"semi-{name}", k) for k, name in enumerate(("major", "minor"))]
    return _start_at_zero(_draw(result, axes, against, curves, "Ellipse of the gross contact", "semi-axis"))


def median_divergence(result: xr.Dataset, axes: Axes | None = None, against: str | None = None) -> Axes:
    """Draw the median divergence and curl over the apparent contact, with bands of two standard deviations.

    Arguments as for `contact_area`.
    """
    names = ["divergence", *(["curl"] if "median_curl" in result else [])]
    curves = [_curve(result, f"median_{name}", name) for name in names]
    return _draw(result, axes, against, curves, "Divergence and curl", "median")


def median_strain(result: xr.Dataset, axes: Axes | None = None, against: str | None = None) -> Axes:
    """Draw the median strain components over the apparent contact; arguments as for `contact_area`."""
    curves = [_curve(result, "median_strain", name, k) for k, name in enumerate(("exx", "eyy", "exy"))]
    return _draw(result, axes, against, curves, "Strain")


def displacement(result: xr.Dataset, axes: Axes | None = None, against: str | None = None) -> Axes:
    """Draw the length of the median displacement of the tracked points; arguments as for `contact_area`."""
    return _start_at_zero(_draw(result, axes, against, [_curve(result, "global_displacement")], "Median displacement"))


def strain_energy(result: xr.Dataset, axes: Axes | None = None, against: str | None = None) -> Axes:
    """Draw the strain energy with a band of two standard deviations; arguments as for `contact_area`."""
    return _start_at_zero(_draw(result, axes, against, [_curve(result, "strain_energy")], "Strain energy"))


def forces(result: xr.Dataset, axes: Axes | None = None, against: str | None = "time") -> Axes:
    """Draw normal and tangential force, by default against time; arguments as for `contact_area`."""
    names = [name for name in ("normal_force", "tangential_force") if name in result] or ["normal_force"]
    curves = [_curve(result, name, name.removesuffix("_force")) for name in names]
    return _draw(result, axes, against, curves, "Forces", "force")


def load_ratio(result: xr.Dataset, axes: Axes | None = None, against: str | None = "time") -> Axes:
    """Draw the ratio of tangential to normal force, by default against time; arguments as for `contact_area`."""
    return _draw(result, axes, against, [_curve(result, "load_ratio")], "Friction ratio")


def tracked_share(result: xr.Dataset, axes: Axes | None = None, against: str | None = "time") -> Axes:
    """Draw the share of points that are tracked, by default against time; arguments as for `contact_area`."""
    drawn = _draw(result, axes, against, [_curve(result, "tracked_share", "tracked")], "Points tracked", "points")
    drawn.set_ylim(0, 103)
    return drawn


def forward_backward(result: xr.Dataset, axes: Axes | None = None, against: str | None = "time") -> Axes:
    """Draw the median forward-backward error, by default against time; arguments as for `contact_area`.

    The frame in which points are seeded is compared with itself and left out.
    """
    name, values, std, variable = _curve(result, "forward_backward_median")
    curve = name, np.where(values > 0, values, np.nan), std, variable
    return _start_at_zero(_draw(result, axes, against, [curve], "Forward-backward distance", "distance"))


def position_std(result: xr.Dataset, axes: Axes | None = None, against: str | None = "time") -> Axes:
    """Draw the standard deviation of tracked positions: median and 0.9 quantile over the points.

    By default against time; the frame in which points are seeded, where all are 0, is left out. Arguments as for
    `contact_area`.
    """
    need(result, "position_std_px")
    values = np.where(result["position_std_px"].values > 0, result["position_std_px"].values, np.nan)
    measured = np.isfinite(values).any(1)
    curves: list[_Curve] = []
    for fraction in (0.5, 0.9):
        rows = np.full(len(values), np.nan)
        rows[measured] = np.nanquantile(values[measured], fraction, axis=1)
        curves.append((f"{fraction:.0%} of the points below", rows, None, "position_std_px"))
    return _start_at_zero(_draw(result, axes, against, curves, "Uncertainty of a position", "standard deviation"))


def need(result: xr.Dataset, *names: str) -> None:
    """Raise FingerflowError if a result lacks any of the given variables."""
    if lacking := [name for name in names if name not in result]:
        raise FingerflowError(
            f"the result has no {', '.join(lacking)}; process the scene again and ask for it (--output)"
        )


def _curve(result: xr.Dataset, name: str, legend: str = "", component: int | None = None) -> _Curve:
    """Return one variable of a result, or its component number `component`, as a curve in its display unit, with its
    standard deviations if the result has them; raise FingerflowError if it lacks the variable.
    """
    need(result, name)

    def shown(of: str) -> Values:
        values = VARIABLES[name].shown_values(result[of].values)
        return values if component is None else values[:, component]

    spread = shown(f"{name}_std") if f"{name}_std" in result else None
    return legend or VARIABLES[name].words, shown(name), spread, name


def _start_at_zero(axes: Axes) -> Axes:
    axes.set_ylim(bottom=0)
    return axes


def _draw(
    result: xr.Dataset, axes: Axes | None, against: str | None, curves: Sequence[_Curve], title: str, words: str = ""
) -> Axes:
    """Draw several curves of a result into one axes, against the variable `against`, with bands of ± BAND standard
    deviations.

    `words` label the vertical axis, with the unit of the first curve; without them its variable does.
    """
    axes = given_or_new(axes)
    variable = VARIABLES[curves[0][-1]]
    label = variable.shown_unit.heading(words) if words else variable.axis_label
    _, x, x_label = abscissa(result, against)
    for (name, values, spread, _), style in zip(curves, line_styles(len(curves)), strict=True):
        drawn = np.isfinite(values) & np.isfinite(x)
        padded = np.pad(drawn, 1)
        alone = drawn & ~padded[:-2] & ~padded[2:]  # frames without known neighbours, which a line would not show
        axes.plot(x, values, marker="." if drawn.sum() < _FEW else "", label=name, **style)
        if alone.any():
            axes.plot(x[alone], values[alone], ".", color=style["color"], label="_alone")
        if spread is not None:
            low, high = values - BAND * spread, values + BAND * spread
            axes.fill_between(x, low, high, color=style["color"], alpha=0.2, linewidth=0)
    axes.set(xlabel=x_label, ylabel=label, title=title, xlim=_frame_limits(x))
    if not any(np.isfinite(values).any() for _, values, *_ in curves):
        axes.text(0.5, 0.5, "not known in any frame", transform=axes.transAxes, ha="center", va="center", color=GREY)
        axes.set_yticks([])
    finished(axes, _caption(curves, title, x_label))
    if len(curves) == 1 and (legend := axes.get_legend()) is not None:
        legend.remove()
    return axes


def _caption(curves: Sequence[_Curve], title: str, against: str) -> str:
    """Return the caption of a figure with curves: definition of each variable, meaning of bands, number of frames."""
    shown = dict.fromkeys(variable for *_, variable in curves)
    sentences = [f"{title} against {against.partition(' (')[0]}."]
    sentences += [definition_text(each) for each in map(VARIABLES.__getitem__, shown) if each.long_name != each.words]
    deviations = dict.fromkeys(f"{variable}_std" for _, _, std, variable in curves if std is not None)
    if deviations:
        meanings = [VARIABLES[name].long_name for name in deviations if name in VARIABLES]
        errors = dict.fromkeys(meaning.partition(" by ")[2] for meaning in meanings)
        sentences.append(f"Bands: {BAND_WORDS}" + "".join(f", by {error}" for error in errors if error) + ".")
    sentences.append(f"n = {max([int(np.isfinite(values).sum()) for _, values, *_ in curves])} frames.")
    return " ".join(sentences)


def _frame_limits(x: Values) -> tuple[float, float]:
    """Return limits of the horizontal axis that include its values `x` in all frames, even in those where the curves
    have no value.
    """
    finite = x[np.isfinite(x)]
    if not len(finite):
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    margin = 0.03 * (high - low) or 0.5
    return low - margin, high + margin
