"""Reader of a result file for the page, which loads single frames, time series and points on demand."""

import json
from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.kernels.arrays import nanmedian
from fingerflow.recordings.guard.checked_hdf5 import open_hdf5
from fingerflow.results.largest_load import frame_of_largest
from fingerflow.results.result import open_result
from fingerflow.schema.rounding import format_uncertainty
from fingerflow.schema.variable_record import LABELS
from fingerflow.schema.variables import shown_unit
from fingerflow.view.key_forms import reword

Array = NDArray[Any]

_SAMPLED = 24  # number of frames that set the range of colours
_RANGE = 0.96  # quantile of the values at the end of the range of colours
_ARROW_PX = 40  # px, drawn length of the largest displacement
_PLACES = ("position", "position_px")  # variables drawn as positions, not as colours
_REGIONS = ("gross_contact_region", "stuck_region")
Values = NDArray[np.floating]


class Results:
    """Result file opened for the page, read on demand.

    A key names what can be shown: a variable and, after a colon, its component: "divergence", "strain:exx",
    "displacement:length".
    """

    def __init__(self, path: Path) -> None:
        """Open a result file; raise FingerflowError if the file is not a result."""
        self.path = path.resolve()
        self.data = open_result(self.path)
        # Open the file directly, too: xarray and h5netcdf look a variable up at each access and take 2 ms for one
        # frame, h5py takes 0.2 ms.
        self._file = open_hdf5(self.path)
        self._stored: dict[str, Any] = {}
        self._ranges: dict[str, tuple[float, float]] = {}
        self._courses = {
            str(name): each.values for name, each in self.data.data_vars.items() if each.dims == ("frame",)
        }

    def close(self) -> None:
        """Close the result file."""
        self.data.close()
        self._stored.clear()
        self._file.close()

    def facts(self) -> dict[str, Any]:
        """Return metadata of the result, and the maps and time series that can be shown, with definitions."""
        data, largest = self.data, frame_of_largest(self.data)
        return {
            "path": str(self.path),
            "frames": data.sizes["frame"],
            "first_frame": int(data["frame"][0]),
            "points": data.sizes.get("point", 0),
            "frame_of_largest_load": data.sizes["frame"] // 2 if largest is None else largest,
            "warnings": [*map(reword, json.loads(data.attrs["warnings"]))],
            "mm_per_px": float(data.attrs["mm_per_px"]),
            "topography_to_contact": json.loads(data.attrs["topography_to_contact"]),
            "maps": self._menu_entries(("frame", "point")) + self._menu_entries(("frame", "triangle")),
            "curves": self._menu_entries(("frame",)),
            "flags": {
                str(name): str(values.attrs["flag_meanings"]).split()
                for name, values in data.data_vars.items()
                if "flag_meanings" in values.attrs
            },
            "triangles": "triangles" in data,
            "cells": [name for name in data if data[name].dims[1:] == ("cell_row", "cell_column")],
            "arrow_scale": self._arrow_scale(),
        }

    def frame(self, frame: int, shown: str | None) -> tuple[dict[str, Any], dict[str, Array]]:
        """Return scalar results by name, and arrays by name (positions, displacements, regions, values of a map), of
        the frame at an index of the result; `shown` is the key of the map, or None.

        Raises:
            FingerflowError: no such frame or key.
        """
        data = self.data
        if not 0 <= frame < data.sizes["frame"]:
            raise FingerflowError(f"frame {frame} is not among the {data.sizes['frame']} of {self.path}")
        numbers = {name: values[frame] for name, values in self._courses.items()}
        numbers["time"], numbers["text"] = float(data["time"][frame]), self._text_of_frame(frame)
        numbers |= {name: self._row(name, frame) for name in ("ellipse_center", "ellipse_semi_axes") if name in data}
        names = [*(("position", "status") if "position" in data else ()), "displacement", *_REGIONS]
        names += ["principal_angle"] if shown is not None and shown.startswith("principal_strains") else []
        kinds = {name: np.uint8 if name in ("status", *_REGIONS) else np.float32 for name in names if name in data}
        arrays: dict[str, Array] = {name: self._row(name, frame).astype(kind) for name, kind in kinds.items()}
        for name in arrays.keys() & {*_REGIONS}:
            numbers[name] = {key: float(data[name].attrs[key]) for key in ("cell_mm", "first_cell_mm")}
        if shown is not None:
            arrays["shown"] = self._frame_values(shown, frame).astype(np.float32)
        return numbers, arrays

    def _text_of_frame(self, frame: int) -> dict[str, str]:
        """Return the scalar results of a frame as text in the shown unit, each with its standard deviation, as reports
        have them: "60.21 ± 0.44"; statuses in words.
        """
        text = {}
        for name, values in self._courses.items():
            attributes, spread = self.data[name].attrs, self._courses.get(f"{name}_std")
            factor = shown_unit(name, str(attributes.get("units", ""))).factor
            if "flag_meanings" in attributes:
                text[name] = str(attributes["flag_meanings"]).split()[values[frame]].replace("_", " ")
            elif not name.endswith(("_std", "_rate")):
                deviation = np.nan if spread is None else factor * spread[frame]
                text[name] = format_uncertainty(factor * values[frame], deviation)
        return text

    def triangles(self) -> NDArray[np.int32]:
        """Return the triangles between tracked points: indices (M, 3) of the points at the corners of M triangles."""
        return np.asarray(self.data["triangles"].values, dtype=np.int32)

    def course(self, key: str) -> Values:
        """Return the time series (F,) that a key names: a variable or component with one value per frame, or "time" in
        s.
        """
        if key == "time":
            return np.asarray(self.data["time"].values, dtype=np.float64)
        values = self._component(key, self.data[self._name(key)].dims, self.data[self._name(key)].values)
        if values.ndim != 1:
            raise FingerflowError(f"{key} is no course of frames: choose one of those that are listed")
        return values

    def point_courses(self, key: str, points: Sequence[int]) -> Values:
        """Return time series (F, K) of the variable that a key names at K selected points, without duplicates and in
        ascending order.
        """
        variable = self.data[self._name(key)]
        if variable.dims[:2] != ("frame", "point"):
            raise FingerflowError(f"{key} is not of points: choose a map of points")
        chosen = np.unique(np.asarray(points, dtype=np.intp))
        if not len(chosen) or chosen[0] < 0 or chosen[-1] >= self.data.sizes["point"]:
            raise FingerflowError(f"the points {list(points)[:5]} are not among the {self.data.sizes['point']} there")
        return self._component(key, variable.dims, variable.isel(point=chosen).values)

    def value_range(self, key: str) -> tuple[float, float]:
        """Return the colour limits, for all frames, of the map that a key names: symmetric about 0 for signed values,
        else starting at 0.

        It is computed from 24 frames, without 4 % of the values at either end.
        """
        if key not in self._ranges:
            count = self.data.sizes["frame"]
            frames = np.unique(np.linspace(0, count - 1, min(count, _SAMPLED)).round().astype(int))
            values = np.concatenate([self._frame_values(key, int(k)).ravel() for k in frames])
            values = values[np.isfinite(values)]
            low, high = np.quantile(values, (1 - _RANGE, _RANGE)) if values.size else (0.0, 1.0)
            high = max(-low, high)
            low = -high if low < 0 else 0.0
            self._ranges[key] = (float(low), float(high) if high > low else float(low) + 1.0)
        return self._ranges[key]

    def table_of_courses(self, keys: Sequence[str], points: Sequence[int], point_key: str | None) -> str:
        """Return the time series of `keys` as CSV text with one row per frame, and with them the median of `point_key`
        over the selected points.
        """
        columns = {"frame": self.data["frame"].values.astype(float), "time (s)": self.course("time")}
        for key in keys:
            columns |= self._column(key, key, self.course(key))
        if point_key and len(points):
            points_named = f"point {points[0]}" if len(points) == 1 else f"median of {len(points)} points"
            median = nanmedian(self.point_courses(point_key, points))
            columns |= self._column(point_key, f"{point_key} of {points_named}", median)
        return _csv(columns)

    def table_of_frame(self, frame: int, shown: str | None) -> str:
        """Return positions, status and the map `shown` in a frame as CSV text with one row per point, or per triangle
        if the map is of triangles.
        """
        of = "point" if shown is None else (*self.data[self._name(shown)].dims, "")[1]
        if of not in ("point", "triangle") or "position" not in self.data:
            raise FingerflowError(
                f"{self.path} has no table of {shown or 'points'}: choose a map of points or triangles"
            )
        _, arrays = self.frame(frame, shown)
        position = arrays["position"].astype(float)
        if of == "triangle":
            position = position[self.triangles()].mean(axis=1)
        columns = {of: np.arange(len(position)), "x (mm)": position[:, 0], "y (mm)": position[:, 1]}
        if of == "point":
            columns["status"] = arrays["status"]
        if shown is not None:
            columns |= self._column(shown, shown, arrays["shown"].astype(float))
        return _csv(columns)

    def _menu_entries(self, dims: tuple[str, ...]) -> list[dict[str, Any]]:
        """Return entries for menus of the page (key, definition and last dimension) of the variables that begin with
        the given dimensions, one for each component.
        """
        entries = []
        for name, variable in self.data.data_vars.items():
            rest = variable.dims[len(dims) :]
            if variable.dims[: len(dims)] != dims or name in _PLACES or any(dim not in LABELS for dim in rest):
                continue
            parts = [""] if not rest else list(LABELS[str(rest[0])])
            if rest == ("xy",) and name != "ellipse_center":  # a vector, other than a position, also has a length
                parts.insert(0, "length")
            for part in parts:
                key = f"{name}:{part}" if part else str(name)
                title = reword(str(variable.attrs.get("long_name", name)))
                entries.append({"key": key, "said": title, "of": dims[-1]})
        return entries

    def _arrow_scale(self) -> float:
        """Return the factor, to one digit, by which arrows are longer than displacements, so that the largest are drawn
        40 px long; 0 if there are no displacements.
        """
        if "displacement" not in self.data:
            return 0.0
        _, largest = self.value_range("displacement:length")
        return float(f"{_ARROW_PX * float(self.data.attrs['mm_per_px']) / largest:.1g}")

    def _name(self, key: str) -> str:
        name = key.partition(":")[0]
        if name not in self.data.data_vars:
            raise FingerflowError(f"{self.path} has no {name!r}: it holds {', '.join(sorted(map(str, self.data)))}")
        return name

    def _column(self, key: str, heading: str, values: Values) -> dict[str, Values]:
        """Return a column of a CSV table by its heading with unit: values of the variable that a key names, converted
        to the unit in which it is shown.
        """
        name = self._name(key)
        unit = shown_unit(name, str(self.data[name].attrs.get("units", "")))
        return {unit.heading(heading): unit.factor * values}

    def _frame_values(self, key: str, frame: int) -> Values:
        name = self._name(key)
        return self._component(key, self.data[name].dims[1:], self._row(name, frame))

    def _row(self, name: str, frame: int) -> Array:
        """Return the stored values of a variable in the frame at an index of the result."""
        if name not in self._stored:
            self._stored[name] = self._file[name]
        return self._stored[name][frame]

    def _component(self, key: str, dims: tuple[Hashable, ...], values: Array) -> Values:
        part, last = key.partition(":")[2], str(dims[-1]) if dims else ""
        values = np.asarray(values, dtype=np.float64)
        if last not in LABELS:
            return values
        if part == "length":
            return np.linalg.norm(values, axis=-1)
        if part not in LABELS[last]:
            raise FingerflowError(f"{key}: the components are {', '.join(LABELS[last])}")
        return values[..., LABELS[last].index(part)]


def _csv(columns: dict[str, Array]) -> str:
    return str(pd.DataFrame(columns).to_csv(index=False, float_format="%.9g", na_rep="nan", lineterminator="\n"))
