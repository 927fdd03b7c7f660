"""Maps of a variable, interpolated from points or triangles of skin to a regular grid on the glass."""

import json

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay, QhullError, cKDTree

from fingerflow.errors import FingerflowError, did_you_mean
from fingerflow.results.tables.columns import Table
from fingerflow.schema.variable_record import LABELS, ShownUnit
from fingerflow.schema.variables import VARIABLES, shown_unit

ORIGIN = "the first pixel is at"  # phrase that identifies a file of maps
_COORDINATES = ("frame", "time", "x", "y")
_MOST_CELLS = 4_000_000  # largest number of grid positions per frame; with more, the step is probably a mistake


def described(maps: xr.DataArray) -> str:
    """Return a text with unit, origin and spacing of maps, for file formats that cannot store these."""
    frame, time, x, y = (maps[name].values[0] for name in _COORDINATES)
    return (
        f"{maps.name} in {maps.attrs['units'] or 1}; {ORIGIN} x = {x:.6g} mm, y = {y:.6g} mm of the glass, pixels are "
        f"{maps.attrs['step_mm']:g} mm apart, the first frame is {frame} at {time:.6g} s"
    )


def map_table(maps: xr.DataArray) -> Table:
    """Return a table with one row for each grid position and frame where the variable of maps is known."""
    frame, row, column = np.nonzero(np.isfinite(maps.values).any(1))
    coordinates = (maps[name].values[at] for name, at in zip(_COORDINATES, (frame, frame, column, row), strict=True))
    headings = (ShownUnit(maps.attrs["units"]).heading(name) for name in maps["component"].values)
    columns = *coordinates, *maps.values[frame, :, row, column].T
    return dict(zip(("frame", "time (s)", "x (mm)", "y (mm)", *headings), columns, strict=True))


def interpolate_maps(result: xr.Dataset, variable: str, step_mm: float) -> xr.DataArray:
    """Interpolate a variable of skin points or triangles, at their positions in each frame, to a regular grid on the
    glass with a spacing of `step_mm`; return maps (frame, component, y, x) in the shown unit, NaN where unknown. The
    only component of a scalar has its name.

    A variable of points is interpolated linearly in the Delaunay triangles of their positions in the frame (Barber et
    al. 1996). It is known within half a gauge length of a point that has a value; farther away no gradient is fitted
    either. A variable of triangles has the value of the triangle that covers the grid position. Where triangles
    overlap, as beside inverted ones, the last of them counts.

    Raises FingerflowError where the variable is missing or not of points or triangles, or the step gives no grid.
    """
    if variable not in result or "position" not in result:
        missing = variable if variable not in result else "position"
        hint = "" if missing in VARIABLES else did_you_mean(missing, map(str, result))
        raise FingerflowError(
            f"the result has no {missing}, which the map needs; {hint or f'compute it (process -v {missing})'}"
        )
    data = result[variable]
    dims = tuple(map(str, data.dims))
    of, parts = dims[:2], dims[2:]
    if of not in (("frame", "point"), ("frame", "triangle")) or len(parts) > 1 or (parts and parts[0] not in LABELS):
        raise FingerflowError(
            f"{variable} has a value for each of {', '.join(dims)}; a map is of what has one for each point or triangle"
        )
    position = result["position"].values
    valid = np.isfinite(position).all(-1)
    if not valid.any():
        raise FingerflowError("no point has a position in any frame: there is nothing to map")
    x, y = (_axis(position[..., k][valid], step_mm) for k in (0, 1))
    if len(x) * len(y) > _MOST_CELLS:
        raise FingerflowError(
            f"a step of {step_mm:g} mm makes maps of {len(y)} x {len(x)} pixels; give a larger one, such as 0.1"
        )
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    reach = float(json.loads(result.attrs["settings"])["fields"]["gauge_length_mm"]) / 2
    components = [f"{variable}_{component}" for component in result[parts[0]].values] if parts else [variable]
    values = np.full((len(position), len(components), len(y), len(x)), np.nan, np.float32)
    corners = result["triangles"].values if "triangle" in dims else None
    for frame, points in enumerate(position):
        of_frame = data[frame].values.reshape(data.shape[1], -1)
        if corners is None:
            gridded = _interpolate_points(points, of_frame, grid, reach)
        else:
            gridded = _values_of_triangles(points[corners], of_frame, x, y)
        values[frame] = gridded.transpose(2, 0, 1)
    unit = shown_unit(variable, str(data.attrs["units"]))
    values *= np.float32(unit.factor)
    coordinates = {"frame": result["frame"].values, "time": ("frame", result["time"].values), "y": y, "x": x}
    attributes = {"units": unit.name, "step_mm": step_mm}
    coordinates["component"] = components
    return xr.DataArray(values, coordinates, ("frame", "component", "y", "x"), variable, attributes)


def _axis(values: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    if not 0 < step < np.inf:
        raise FingerflowError(f"a step of {step:g} mm gives no grid; give one above 0, such as 0.1")
    first, last = np.floor(values.min() / step), np.ceil(values.max() / step)
    return np.arange(first, last + 1) * step


def _interpolate_points(
    points: NDArray[np.float64], values: NDArray[np.floating], grid: NDArray[np.float64], reach: float
) -> NDArray[np.float64]:
    """Interpolate values (N, C) of the points (N, 2) in one frame linearly to the grid positions `grid` (H, W, 2) mm,
    and return them as (H, W, C).

    The result is NaN farther than `reach` from all points.
    """
    gridded = np.full((*grid.shape[:2], values.shape[1]), np.nan)
    usable = np.isfinite(points).all(1) & np.isfinite(values).all(1)
    if usable.sum() < 3:
        return gridded
    try:
        between = LinearNDInterpolator(Delaunay(points[usable]), values[usable].astype(np.float64))
    except QhullError:  # all points lie on one line
        return gridded
    near = cKDTree(points[usable]).query(grid, distance_upper_bound=reach)[0] <= reach
    gridded[near] = between(grid[near])
    return gridded


def _values_of_triangles(
    corners: NDArray[np.float64], values: NDArray[np.floating], x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the values (H, W, C) at the grid positions (y, x) of one frame, each that of the triangle which covers the
    position, of `corners` (M, 3, 2); NaN where none does.
    """
    gridded = np.full((len(y), len(x), values.shape[1]), np.nan)
    for triangle, value in zip(corners, values, strict=True):
        if not (np.isfinite(triangle).all() and np.isfinite(value).any()):
            continue
        low, high = triangle.min(0), triangle.max(0)
        columns = slice(np.searchsorted(x, low[0]), np.searchsorted(x, high[0], "right"))
        rows = slice(np.searchsorted(y, low[1]), np.searchsorted(y, high[1], "right"))
        right, down = np.meshgrid(x[columns], y[rows])
        sides = zip(triangle, np.roll(triangle, -1, axis=0) - triangle, strict=True)
        products = np.array(
            [across * (down - begin_y) - along * (right - begin_x) for (begin_x, begin_y), (across, along) in sides]
        )
        inside = (products >= 0).all(0) | (products <= 0).all(0)
        gridded[rows, columns][inside] = value
    return gridded
