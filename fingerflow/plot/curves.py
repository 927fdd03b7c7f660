"""Curves of a result, each drawn into one axes: areas, deformation, energy, forces, quality."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.plot.abscissa import abscissa
from fingerflow.plot.axes_style import BAND, GREEN, GREY, INK, RED, YELLOW, finished, given_or_new
from fingerflow.plot.wording import followed

Values = NDArray[np.float64]
_MICRO = 1000.0  # mm to µm, and 1 to µm/mm
_FEW = 60  # frames: fewer are drawn as dots


def contact_area(result: xr.Dataset, axes: Axes | None = None, against: str | None = None) -> Axes:
    """Draw the gross and real contact area (mm²).

    Args:
        result: returned by `fingerflow.process`, or a result that was opened.
        axes: axes to draw into; None for a new figure.
        against: variable of the horizontal axis; None for the normal force where it only rises or falls, else time.

    Returns:
        The axes; save the figure by ``axes.figure.savefig("area.pdf")``.

    Raises:
        FingerflowError: the result lacks a variable that is drawn.
    """
    need(result, "gross_contact_area")
    curves = [("gross", result["gross_contact_area"].values, None)]
    # A soft sensor shows no micro-junctions.
    if "real_contact_area" in result and np.isfinite(result["real_contact_area"].values).any():
        curves.append(("real", result["real_contact_area"].values, None))
    drawn = _draw(result, axes, against, curves, "contact area (mm²)", "Contact area")
    drawn.set_ylim(bottom=0)
    return drawn


def contact_axes(result: xr.Dataset, axes: Axes | None = None, against: str | None = None) -> Axes:
    """Draw the semi-axes (mm) of the ellipse of the gross contact; arguments as for `contact_area`."""
    need(result, "ellipse_semi_axes")
    values = result["ellipse_semi_axes"].values
    curves = [("semi-major", values[:, 0], None), ("semi-minor", values[:, 1], None)]
    drawn = _draw(result, axes, against, curves, "semi-axis (mm)", "Ellipse of the gross contact")
    drawn.set_ylim(bottom=0)
    return drawn


def median_divergence(result: xr.Dataset, axes: Axes | None = None, against: str | None = None) -> Axes:
    """Draw the median divergence and curl (µm/mm) over the gross contact, with bands of two standard deviations.

    Arguments as for `contact_area`.
    """
    need(result, "median_divergence")
    curves = [
        (name, _MICRO * result[f"median_{name}"].values, _std(result, f"median_{name}", _MICRO))
        for name in ("divergence", "curl")
        if f"median_{name}" in result
    ]
    return _draw(result, axes, against, curves, "median (µm/mm)", "Divergence and curl")


def median_strain(result: xr.Dataset, axes: Axes | None = None, against: str | None = None) -> Axes:
    """Draw the median strain components (µm/mm) over the gross contact; arguments as for `contact_area`."""
    need(result, "median_strain")
    values = _MICRO * result["median_strain"].values
    spread = _std(result, "median_strain", _MICRO)
    curves = [
        (name, values[:, k], None if spread is None else spread[:, k]) for k, name in enumerate(("exx", "eyy", "exy"))
    ]
    return _draw(result, axes, against, curves, "median strain (µm/mm)", "Strain")


def displacement(result: xr.Dataset, axes: Axes | None = None, against: str | None = None) -> Axes:
    """Draw the length of the median displacement of the points (µm).

    For a soft sensor, draw the mean displacement of the markers in contact along x and y. Arguments as for
    `contact_area`.
    """
    if "contact_displacement" in result:
        values = _MICRO * result["contact_displacement"].values
        curves = [(name, values[:, k], None) for k, name in enumerate("xy")]
        return _draw(result, axes, against, curves, "mean displacement (µm)", "Displacement in contact")
    need(result, "global_displacement")
    curves = [("global displacement", _MICRO * result["global_displacement"].values, None)]
    drawn = _draw(result, axes, against, curves, "displacement (µm)", "Median displacement")
    drawn.set_ylim(bottom=0)
    return drawn


def strain_energy(result: xr.Dataset, axes: Axes | None = None, against: str | None = None) -> Axes:
    """Draw the strain energy (mJ) with a band of two standard deviations; arguments as for `contact_area`."""
    need(result, "strain_energy")
    curves = [("strain energy", result["strain_energy"].values, _std(result, "strain_energy", 1.0))]
    return _draw(result, axes, against, curves, "strain energy (mJ)", "Strain energy")


def forces(result: xr.Dataset, axes: Axes | None = None, against: str | None = "time") -> Axes:
    """Draw normal and tangential force (N), by default against time; arguments as for `contact_area`."""
    names = [name for name in ("normal_force", "tangential_force") if name in result]
    if not names:
        need(result, "normal_force")
    curves = [(name.removesuffix("_force"), result[name].values, None) for name in names]
    return _draw(result, axes, against, curves, "force (N)", "Forces")


def load_ratio(result: xr.Dataset, axes: Axes | None = None, against: str | None = "time") -> Axes:
    """Draw the tangential over the normal force, by default against time; arguments as for `contact_area`."""
    need(result, "load_ratio")
    return _draw(result, axes, against, [("T/N", result["load_ratio"].values, None)], "T/N", "Load ratio")


def slip_ratio(result: xr.Dataset, axes: Axes | None = None, against: str | None = "time") -> Axes:
    """Draw the share of a soft sensor's markers in contact that have slipped, with gross slip marked.

    By default against time; arguments as for `contact_area`.
    """
    need(result, "slip_ratio", "gross_slip")
    x = abscissa(result, against)
    curves = [("share that has slipped", result["slip_ratio"].values, None)]
    drawn = _draw(result, axes, against, curves, "slip ratio", "Slip of what touches the gel")
    drawn.set_ylim(-0.03, 1.03)
    for k, where in enumerate(x.values[result["gross_slip"].values > 0]):
        drawn.axvline(where, color=YELLOW, linewidth=2, zorder=0, label=None if k else "gross slip")
    return finished(drawn)


def tracked_share(result: xr.Dataset, axes: Axes | None = None, against: str | None = "time") -> Axes:
    """Draw the share of points that are tracked (%), by default against time; arguments as for `contact_area`."""
    need(result, "tracked_share")
    name, curves = followed(result), [("tracked", 100 * result["tracked_share"].values, None)]
    drawn = _draw(result, axes, against, curves, f"{name} (%)", f"{name.capitalize()} tracked")
    drawn.set_ylim(0, 103)
    return drawn


def forward_backward(result: xr.Dataset, axes: Axes | None = None, against: str | None = "time") -> Axes:
    """Draw the median forward-backward distance (px), by default against time; arguments as for `contact_area`.

    The frame in which points are seeded is compared with itself and left out.
    """
    need(result, "forward_backward_median")
    values = result["forward_backward_median"].values
    curves = [("median", np.where(values > 0, values, np.nan), None)]
    drawn = _draw(result, axes, against, curves, "distance (px)", "Forward-backward distance")
    drawn.set_ylim(bottom=0)
    return drawn


def position_std(result: xr.Dataset, axes: Axes | None = None, against: str | None = "time") -> Axes:
    """Draw the standard deviation of a position (px): median and 0.9 quantile over the points.

    By default against time; the frame in which points are seeded, where all are 0, is left out. Arguments as for
    `contact_area`.
    """
    need(result, "position_std_px")
    values = np.where(result["position_std_px"].values > 0, result["position_std_px"].values, np.nan)
    known = np.isfinite(values).any(1)
    curves = []
    for fraction in (0.5, 0.9):
        rows = np.full(len(values), np.nan)
        rows[known] = np.nanquantile(values[known], fraction, axis=1)
        curves.append((f"{fraction:.0%} of the {followed(result)} below", rows, None))
    drawn = _draw(result, axes, against, curves, "standard deviation (px)", "Uncertainty of a position")
    drawn.set_ylim(bottom=0)
    return drawn


def need(result: xr.Dataset, *names: str) -> None:
    """Raise FingerflowError if a result lacks any of these variables."""
    if lacking := [name for name in names if name not in result]:
        raise FingerflowError(
            f"the result has no {', '.join(lacking)}; process the scene again and ask for it (--output)"
        )


def _std(result: xr.Dataset, name: str, factor: float) -> Values | None:
    return factor * result[f"{name}_std"].values if f"{name}_std" in result else None


def _draw(
    result: xr.Dataset,
    axes: Axes | None,
    against: str | None,
    curves: Sequence[tuple[str, Values, Values | None]],
    label: str,
    title: str,
) -> Axes:
    """Draw curves (name, values, standard deviation or None) with bands of BAND standard deviations."""
    axes = given_or_new(axes)
    x = abscissa(result, against)
    for (name, values, spread), colour in zip(curves, (INK, RED, YELLOW, GREEN, GREY), strict=False):
        known = np.isfinite(values) & np.isfinite(x.values)
        beside = np.pad(known, 1)
        alone = known & ~beside[:-2] & ~beside[2:]  # frames without known neighbours, which a line does not show
        axes.plot(x.values, values, ".-" if known.sum() < _FEW else "-", color=colour, label=name)
        if alone.any():
            axes.plot(x.values[alone], values[alone], ".", color=colour, label="_alone")
        if spread is not None:
            low, high = values - BAND * spread, values + BAND * spread
            axes.fill_between(x.values, low, high, color=colour, alpha=0.2, linewidth=0)
    axes.set(xlabel=x.label, ylabel=label, title=title, xlim=_whole(x.values))
    if not any(np.isfinite(values).any() for _, values, _ in curves):
        axes.text(0.5, 0.5, "not known in any frame", transform=axes.transAxes, ha="center", va="center", color=GREY)
        axes.set_yticks([])
    finished(axes)
    if len(curves) == 1 and (legend := axes.get_legend()) is not None:
        legend.remove()
    return axes


def _whole(x: Values) -> tuple[float, float]:
    """Return limits that show every frame, even those without a value."""
    known = x[np.isfinite(x)]
    if not len(known):
        return 0.0, 1.0
    low, high = float(known.min()), float(known.max())
    margin = 0.03 * (high - low) or 0.5
    return low - margin, high + margin
