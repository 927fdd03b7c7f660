"""The figures of the report, each from the data set to a PNG."""

import io
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

INK = "#1f3b57"


def areas(result: xr.Dataset) -> bytes:
    """Areas and semi-axes of the contact against force, or time."""
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    x, name = abscissa(result)
    left.plot(x, result["gross_contact_area"], color=INK, label="gross")
    if np.isfinite(result["real_contact_area"].values).any():  # a soft sensor shows none
        left.plot(x, result["real_contact_area"], color="#d1495b", label="real")
    left.set(xlabel=name, ylabel="contact area (mm²)")
    axes = result["ellipse_semi_axes"].values
    right.plot(x, axes[:, 0], color=INK, label="semi-major")
    right.plot(x, axes[:, 1], color="#d1495b", label="semi-minor")
    right.set(xlabel=name, ylabel="semi-axis of the ellipse (mm)")
    return _png(figure, left, right)


def sensor_slip(result: xr.Dataset) -> bytes:
    """Displacement of the markers in contact and the share of them that has slipped, with the frames of gross slip."""
    figure = Figure(figsize=(10, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    time = result["time"].values
    for k, (name, colour) in enumerate(zip("xy", (INK, "#d1495b"), strict=True)):
        left.plot(time, result["contact_displacement"].values[:, k], ".-", color=colour, label=name)
    left.set(xlabel="time (s)", ylabel="mean displacement in contact (mm)")
    right.plot(time, result["slip_ratio"].values, ".-", color=INK, label="share that has slipped")
    right.set(xlabel="time (s)", ylabel="slip ratio", ylim=(-0.03, 1.03), xlim=left.get_xlim())
    for axes in (left, right):
        for k, moment in enumerate(time[result["gross_slip"].values > 0]):
            axes.axvline(moment, color="#edae49", linewidth=2, zorder=0, label=None if k else "gross slip")
    return _png(figure, left, right)


def medians(result: xr.Dataset) -> bytes:
    """Medians of the fields over the gross contact, and the strain energy; of a stream the divergence alone."""
    x, name = abscissa(result)
    if "global_displacement" not in result:
        figure = Figure(figsize=(10, 3.4), layout="constrained")
        alone = figure.subplots()
        alone.plot(x, 1000 * result["median_divergence"].values, color=INK, label="divergence")
        alone.set(xlabel=name, ylabel="median (µm/mm)")
        return _png(figure, alone)
    figure = Figure(figsize=(10, 6.4), layout="constrained")
    (upper_left, upper_right), (lower_left, lower_right) = figure.subplots(2, 2)
    value, spread = 1000 * result["median_divergence"].values, 1000 * result["median_divergence_std"].values
    upper_left.fill_between(
        x, value - 2 * spread, value + 2 * spread, color=INK, alpha=0.2, linewidth=0, label="± 2 std"
    )
    upper_left.plot(x, value, color=INK, label="divergence")
    upper_left.plot(x, 1000 * result["median_curl"].values, color="#d1495b", label="curl")
    upper_left.set(xlabel=name, ylabel="median (µm/mm)")
    for k, (component, colour) in enumerate(zip(("exx", "eyy", "exy"), (INK, "#d1495b", "#edae49"), strict=True)):
        upper_right.plot(x, 1000 * result["median_strain"].values[:, k], color=colour, label=component)
    upper_right.set(xlabel=name, ylabel="median strain (µm/mm)")
    lower_left.plot(x, 1000 * result["global_displacement"].values, color=INK, label="global displacement")
    lower_left.set(xlabel=name, ylabel="displacement (µm)")
    if "strain_energy" in result:
        lower_right.plot(x, result["strain_energy"], color=INK, label="strain energy")
    lower_right.set(xlabel=name, ylabel="strain energy (mJ)")
    return _png(figure, upper_left, upper_right, lower_left, lower_right)


def maps(result: xr.Dataset, frame: int) -> bytes:
    """Divergence at the points and the strain of the triangles, where they are on the glass in one frame."""
    figure = Figure(figsize=(10, 7.6), layout="constrained")
    places = figure.subplots(2, 2)
    position = result["position"].values[frame]
    # A triangle is drawn where all of its corners are; the others keep a place that is never shown.
    corners = result["triangles"].values
    whole = np.isfinite(position[corners]).all((1, 2))
    filled = np.nan_to_num(position)
    strain = result["strain"].values[frame]
    panels: list[tuple[str, NDArray[Any]]] = [("divergence", result["divergence"].values[frame][corners].mean(1))]
    panels += [(name, strain[:, k]) for k, name in enumerate(("exx", "eyy", "exy"))]
    for axes, (name, values) in zip(places.flat, panels, strict=True):
        shown = whole & np.isfinite(values)
        axes.set(title=name, xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
        axes.invert_yaxis()
        if not shown.any():
            continue
        limit = max(1000 * float(np.quantile(np.abs(values[shown]), 0.98)), 1e-9)
        mesh = Triangulation(filled[:, 0], filled[:, 1], corners[shown])
        colours = axes.tripcolor(mesh, facecolors=1000 * values[shown], cmap="RdBu_r", vmin=-limit, vmax=limit)
        used = filled[np.unique(corners[shown])]
        axes.set_xlim(used[:, 0].min() - 0.3, used[:, 0].max() + 0.3)
        axes.set_ylim(used[:, 1].max() + 0.3, used[:, 1].min() - 0.3)
        figure.colorbar(colours, ax=axes, label="µm/mm")
    return _png(figure)


def quality(result: xr.Dataset) -> bytes:
    """Share of points tracked, forward-backward error and standard deviation against time."""
    figure = Figure(figsize=(10, 3.2), layout="constrained")
    share, error, deviation = figure.subplots(1, 3)
    time = result["time"].values
    share.plot(time, 100 * result["tracked_share"].values, color=INK)
    share.set(xlabel="time (s)", ylabel="points tracked (%)", ylim=(0, 103))
    error.semilogy(time, np.maximum(result["forward_backward_median"].values, 1e-6), color=INK)
    error.set(xlabel="time (s)", ylabel="median forward-backward error (px)")
    values = result["position_std_px"].values
    for fraction, style in ((0.5, "-"), (0.9, "--")):
        rows = [np.quantile(row[np.isfinite(row)], fraction) if np.isfinite(row).any() else np.nan for row in values]
        deviation.plot(time, rows, style, color=INK, label=f"{fraction:.0%} of the points below")
    deviation.set(xlabel="time (s)", ylabel="standard deviation of a position (px)")
    return _png(figure, deviation)


def abscissa(result: xr.Dataset) -> tuple[NDArray[np.float64], str]:
    """What results are drawn against: the normal force where there is one, else time."""
    if "normal_force" in result and np.isfinite(result["normal_force"].values).any():
        return result["normal_force"].values, "normal force (N)"
    return result["time"].values, "time (s)"


def _png(figure: Figure, *legends: Axes) -> bytes:
    for axes in figure.axes:
        axes.grid(alpha=0.25)
    for axes in legends:
        if axes.get_legend_handles_labels()[0]:
            axes.legend(frameon=False)
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110)
    return data.getvalue()
