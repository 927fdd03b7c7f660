"""Conversion of a result to tables with named columns."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.schema.variable_record import LABELS
from fingerflow.schema.variables import shown_unit

#: Columns (R,) of a table of R rows, by their names with shown units.
Table = dict[str, NDArray[Any]]


def frame_table(result: xr.Dataset, variables: Sequence[str] | None) -> Table:
    """Return a table with one row per frame: frame number, time, and the variables that have one value or vector per
    frame.
    """
    columns = {"frame": result["frame"].values, **_component_columns(result["time"])}
    for values in _select(result, variables, ("frame",)):
        columns |= _component_columns(values)
    return columns


def point_table(result: xr.Dataset, variables: Sequence[str] | None) -> Table:
    """Return a table with one row per point and frame: frame number, time, point number, and the variables that have a
    value for each point.

    A variable of points alone, such as the onset, is repeated in every frame.
    """
    frames, points = _sizes(result)
    columns = {"frame": np.repeat(result["frame"].values, points)}
    columns |= {name: np.repeat(column, points) for name, column in _component_columns(result["time"]).items()}
    columns["point"] = np.tile(np.arange(points), frames)
    for values in _select(result, variables, ("frame", "point"), ("point",)):
        for name, column in _component_columns(values).items():
            columns[name] = column.reshape(-1) if values.dims[0] == "frame" else np.tile(column, frames)
    return columns


def track_table(result: xr.Dataset, variables: Sequence[str] | None) -> Table:
    """Return the tracks of all points as a table for `napari.layers.Tracks`, with columns track ID, frame number, y and
    x (px), sorted by ID and frame.

    Rows exist where a point is tracked. The named `variables` are further columns, napari's properties.
    """
    if "position_px" not in result:
        raise FingerflowError("the result has no position_px, of which tracks are; compute it, or the rows of frames")
    frames, points = _sizes(result)
    position = result["position_px"].values.transpose(1, 0, 2).reshape(-1, 2)
    columns = {
        "track_id": np.repeat(np.arange(points), frames),
        "t": np.tile(result["frame"].values, points),
        "y": position[:, 1],
        "x": position[:, 0],
    }
    for values in _select(result, variables, ("frame", "point")) if variables else ():
        columns |= {name: column.T.reshape(-1) for name, column in _component_columns(values).items()}
    tracked = np.isfinite(position).all(1)
    return {name: column[tracked] for name, column in columns.items()}


def _sizes(result: xr.Dataset) -> tuple[int, int]:
    if "point" not in result.sizes:
        raise FingerflowError("the result has no points; compute an output of them, such as position")
    return result.sizes["frame"], result.sizes["point"]


def _select(result: xr.Dataset, variables: Sequence[str] | None, *dims: tuple[str, ...]) -> Iterator[xr.DataArray]:
    """Yield the variables of a result whose dimensions, apart from that of vector components, are one of the tuples
    `dims`: those named in `variables`, or all if None.
    """

    def fits(values: xr.DataArray) -> bool:
        of_it = tuple(map(str, values.dims))
        return of_it in dims or (of_it[:-1] in dims and of_it[-1] in LABELS)

    for name in result.data_vars if variables is None else variables:
        if name not in result:
            there = [str(variable) for variable in result.data_vars if fits(result[variable])]
            raise FingerflowError(f"the result has no {name}; of such rows it has {', '.join(there)}")
        if fits(result[name]):
            yield result[name]
        elif variables is not None:
            raise FingerflowError(
                f"{name} has a value for each of {', '.join(map(str, result[name].dims))}, not for each "
                f"{' and '.join(dims[0])}; take other rows, or leave it out"
            )


def _component_columns(values: xr.DataArray) -> Table:
    """Return the values of a variable, in the unit in which tables show it, as a mapping from column name to values,
    with one column per component.
    """
    shown = shown_unit(str(values.name), values.attrs["units"])
    numbers = values.values if shown.factor == 1 else shown.factor * values.values
    if values.dims[-1] not in LABELS:
        return {shown.heading(str(values.name)): numbers}
    parts = values[values.dims[-1]].values
    return {shown.heading(f"{values.name}_{part}"): numbers[..., k] for k, part in enumerate(parts)}
