"""Maps of one frame: a quantity of the skin as colour over the position on the glass."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.ops.fields.strain import principal_strains
from fingerflow.plot.axes_style import GREY, INK, finished, given_or_new
from fingerflow.plot.captions import frame_text
from fingerflow.plot.outlines import contact_outline
from fingerflow.results.napari_reader import DIVERGING
from fingerflow.schema.rounding import format_uncertainty
from fingerflow.schema.variable_record import LABELS
from fingerflow.schema.variables import VARIABLES

Values = NDArray[np.float64]
_SHOWN = 0.98  # quantile of the absolute values that limits a colour scale
_OF_MEDIAN = 3.0  # largest limit as a multiple of the median, since more than 2 % of the triangles may be torn
# Approximate number of arrows of displacement and of lines of principal direction in a map.
_ARROWS, _DIRECTIONS = 220, 260
_MARGIN_MM = 0.3


@dataclass(frozen=True)
class Quantity:
    """Quantity that a map shows: title, variable of the result, and function that computes it from that variable.

    Attributes:
        title: of the map.
        variable: from which it is computed; it states the unit.
        compute: function from a frame to the values in the unit of the data set; None for the variable itself.
        signed: the colour scale is symmetric about 0.
    """

    title: str
    variable: str
    compute: Callable[[xr.Dataset], Values] | None = None
    signed: bool = True

    @property
    def triangle_mean(self) -> bool:
        """Return True if the quantity has one value per triangle, False if one per point."""
        return "triangle" in VARIABLES[self.variable].dims

    @property
    def unit(self) -> str:
        """Return the unit in which the map shows the quantity."""
        return VARIABLES[self.variable].shown_unit.name

    def values(self, frame: xr.Dataset) -> Values:
        """Return the values of the quantity in one frame, in the unit of the map."""
        values = frame[self.variable].values if self.compute is None else self.compute(frame)
        return np.asarray(VARIABLES[self.variable].shown_values(values), dtype=np.float64)


def principal(frame: xr.Dataset) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the principal strains (M, 2) of M triangles of a frame, major first, and the direction (M,) of the
    major strain, rad, from x towards y.
    """
    return principal_strains(torch.from_numpy(frame["strain"].values.astype(np.float64)))


def _component(variable: str, number: int, frame: xr.Dataset) -> Values:
    return frame[variable].values[:, number]


#: Quantities of `field_map`, by name.
QUANTITIES: dict[str, Quantity] = {
    "divergence": Quantity("Divergence", "divergence"),
    "curl": Quantity("Curl", "curl"),
    "displacement": Quantity(
        "Displacement", "displacement", lambda frame: np.linalg.norm(frame["displacement"].values, axis=-1), False
    ),
    "strain_energy_density": Quantity("Strain energy density", "strain_energy_density", signed=False),
    "decorrelation": Quantity(
        "Loss of subset correlation", "subset_correlation", lambda frame: 1 - frame["subset_correlation"].values, False
    ),
    "major_strain": Quantity("Major principal strain", "strain", lambda frame: principal(frame)[0][:, 0].numpy()),
    "minor_strain": Quantity("Minor principal strain", "strain", lambda frame: principal(frame)[0][:, 1].numpy()),
    **{
        f"{component}{suffix}": Quantity(f"{words} {component}", variable, partial(_component, variable, k))
        for variable, suffix, words in (("strain", "", "Strain"), ("strain_rate", "_rate", "Strain rate"))
        for k, component in enumerate(LABELS["strain_component"])
    },
}


def field_map(
    result: xr.Dataset, quantity: str, frame: int, axes: Axes | None = None, limit: float | None = None
) -> Axes:
    """Draw a map of a quantity in one frame over the glass (mm, y down), with the outline of the contact.

    Divergence, curl and displacement are quantities of the points: a triangle has the mean of its corners. The others
    are quantities of the triangles. The map of displacement has arrows, magnified as its title states; maps of
    principal strain have lines along its direction.

    Args:
        result: returned by `fingerflow.process`, or a result that was opened.
        quantity: a name in `QUANTITIES`.
        frame: index of the frame in the result, from 0.
        axes: axes to draw into; None for a new figure.
        limit: of the colours, in the unit of the map; None for that of this frame (`colour_limit`). Give the same
        limit to maps that are compared.

    Returns:
        The axes, with a note if nothing is known in this frame.

    Raises:
        FingerflowError: no such quantity or frame, or the result lacks a variable that the quantity needs.
    """
    chosen = _needed(result, quantity)
    if not 0 <= frame < result.sizes["frame"]:
        raise FingerflowError(f"frame {frame}: the result has {result.sizes['frame']}, from 0 on")
    axes = given_or_new(axes, 0.76)
    data = result.isel(frame=frame)
    axes.set(title=chosen.title, xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    axes.set_axisbelow(True)  # draws the grid below the colours
    outline = contact_outline(data)
    if outline is not None:
        axes.plot(*np.append(outline, outline[:1], 0).T, "--", color=INK, linewidth=1, label="_contact")
    position, values = data["position"].values, chosen.values(data)
    corners = result["triangles"].values if "triangles" in result else np.zeros((0, 3), np.int32)
    limit = colour_limit(result, quantity, (frame,)) if limit is None else limit
    low, colours_of = (-limit, DIVERGING) if chosen.signed else (0.0, "viridis")
    scale: dict[str, Any] = {"cmap": colours_of, "vmin": low, "vmax": limit}
    whole = np.isfinite(position[corners]).all((1, 2))
    by_triangle = values if chosen.triangle_mean else values[corners].mean(1)
    shown = whole & np.isfinite(by_triangle)
    dots = np.isfinite(values) & np.isfinite(position).all(1) if not chosen.triangle_mean else np.zeros(0, dtype=bool)
    if shown.any():
        # Draw a triangle only if all its corners are known: unknown positions become 0 and are never shown.
        filled = np.nan_to_num(position)
        mesh = Triangulation(filled[:, 0], filled[:, 1], corners[shown])
        colours = axes.tripcolor(mesh, facecolors=by_triangle[shown], **scale)
        used = filled[np.unique(corners[shown])]
    elif dots.any():
        used = position[dots]
        colours = axes.scatter(used[:, 0], used[:, 1], c=values[dots], s=14, **scale)
    else:
        axes.text(0.5, 0.5, "not known in this frame", transform=axes.transAxes, ha="center", va="center", color=GREY)
        _set_limits(axes, outline)
        return finished(axes)
    colours.set_rasterized(True)  # thousands of triangles make a small file only as an image
    if quantity == "displacement":
        _arrows(axes, data, chosen.title)
    elif quantity in ("major_strain", "minor_strain") and np.any(values[shown]):
        _directions(axes, data, shown, corners, minor=quantity == "minor_strain")
    _set_limits(axes, used if outline is None else np.concatenate((used, outline)))
    most = float(np.nanmax(np.abs(values)))
    beyond = "neither" if most <= limit else "both" if chosen.signed else "max"
    whole_figure = axes.get_figure(root=True)
    assert whole_figure is not None
    whole_figure.colorbar(colours, ax=axes, label=chosen.unit, extend=beyond, shrink=0.8)
    return finished(axes, _caption(chosen, data, limit, int(shown.sum() or dots.sum()), bool(shown.any())))


def colour_limit(result: xr.Dataset, quantity: str, frames: Sequence[int]) -> float:
    """Return the colour-scale limit that the maps of a quantity in several frames share, in the unit of the map.

    It is the largest over these frames of the 0.98 quantile of the absolute values, at most three times their median; 1
    if all are 0.
    """
    chosen = _needed(result, quantity)
    largest = 0.0
    for frame in frames:
        values = np.abs(chosen.values(result.isel(frame=frame)))
        values = values[np.isfinite(values)]
        if len(values):
            middle, high = np.quantile(values, (0.5, _SHOWN))
            largest = max(largest, float(min(high, _OF_MEDIAN * middle) or high))
    return largest or 1.0


def drawable(result: xr.Dataset) -> list[str]:
    """Return the names in `QUANTITIES` that can be drawn from the variables of a result."""
    return [name for name, quantity in QUANTITIES.items() if _has(result, quantity)]


def _has(result: xr.Dataset, quantity: Quantity) -> bool:
    names = ("position", quantity.variable, *(("triangles",) if quantity.triangle_mean else ()))
    return all(name in result and result[name].size for name in names)


def _needed(result: xr.Dataset, name: str) -> Quantity:
    if name not in QUANTITIES:
        raise FingerflowError(f"{name!r} is no map; choose one of {', '.join(QUANTITIES)}")
    if not _has(result, QUANTITIES[name]):
        raise FingerflowError(
            f"a map of {name} needs position, {QUANTITIES[name].variable}, which the result has not; process the scene "
            "for them"
        )
    return QUANTITIES[name]


def _caption(chosen: Quantity, frame: xr.Dataset, limit: float, count: int, triangles: bool) -> str:
    what = "triangles" if triangles else "points"
    definition = VARIABLES[chosen.variable].long_name
    mean = ", mean of the corners of each triangle" if triangles and not chosen.triangle_mean else ""
    return (
        f"{chosen.title}, {frame_text(frame)}: {definition}{mean}. Dashed: the gross contact. The colours end at "
        f"{format_uncertainty(limit)} {chosen.unit}. n = {count} {what}."
    )


def _arrows(axes: Axes, frame: xr.Dataset, title: str) -> None:
    position, moved = frame["position"].values, frame["displacement"].values
    chosen = np.flatnonzero(np.isfinite(position).all(1) & np.isfinite(moved).all(1))
    chosen = chosen[_select_spread(position[chosen], _ARROWS)]
    length = np.linalg.norm(moved[chosen], axis=1)
    long = float(np.quantile(length, 0.95)) if len(chosen) else 0.0
    if long <= 0:
        return
    width = float(np.ptp(position[chosen], axis=0).max()) or 1.0
    # Rounded to one digit; the 0.95 quantile is drawn as an eighth of the width.
    scale = float(f"{width / 8 / long:.1g}")
    axes.quiver(
        *position[chosen].T, *(scale * moved[chosen]).T, angles="xy", scale_units="xy", scale=1,
        color="white", edgecolor=INK, linewidth=0.3, width=0.006,
    )  # fmt: skip
    axes.set_title(f"{title}, arrows {scale:g} ×")


def _directions(
    axes: Axes, frame: xr.Dataset, shown: NDArray[np.bool_], corners: NDArray[np.integer], minor: bool
) -> None:
    """Draw short lines along the major (or minor) principal strain at the centres of evenly spread triangles, selected
    from those in the mask `shown`; `corners` holds the point indices of all triangles.
    """
    middle = frame["position"].values[corners].mean(1)
    angle = principal(frame)[1].numpy() + (np.pi / 2 if minor else 0)
    chosen = np.flatnonzero(shown)
    chosen = chosen[_select_spread(middle[chosen], _DIRECTIONS)]
    spacing = float(np.sqrt(np.prod(np.maximum(np.ptp(middle[chosen], axis=0), 0.1)) / max(len(chosen), 1)))
    half = spacing / 2 * np.stack((np.cos(angle[chosen]), np.sin(angle[chosen])), 1)
    lines = np.stack((middle[chosen] - half, middle[chosen] + half), 1)
    axes.add_collection(LineCollection(list(lines), colors=INK, linewidths=0.7), autolim=False)


def _select_spread(positions: Values, most: int) -> NDArray[np.intp]:
    """Select about `most` of the positions (N, 2), evenly spread over the area that they cover, and return their
    indices.

    Of each cell of a grid, the position nearest to the centre is selected.
    """
    if len(positions) <= most:
        return np.arange(len(positions))
    low, span = positions.min(0), np.maximum(np.ptp(positions, axis=0), 1e-9)
    side = float(np.sqrt(np.prod(span) / most))
    cell = np.floor((positions - low) / side).astype(int)
    distance = np.linalg.norm((positions - low) / side - cell - 0.5, axis=1)
    order = np.argsort(distance, kind="stable")
    _, first = np.unique(cell[order], axis=0, return_index=True)
    return np.sort(order[first])


def _set_limits(axes: Axes, positions: Values | None) -> None:
    """Set the axis limits of a map so that it includes all positions (N, 2) mm, with y pointing down."""
    if positions is not None:
        low, high = positions.min(0) - _MARGIN_MM, positions.max(0) + _MARGIN_MM
        axes.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]))
    elif not axes.yaxis_inverted():
        axes.invert_yaxis()
