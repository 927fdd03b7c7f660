"""Conversion of the results folder of a stream to a labelled data set, as `process` returns."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fingerflow.errors import FingerflowError
from fingerflow.recordings.lens import Geometry
from fingerflow.results.store import labelled
from fingerflow.results.stream_folder import Array, StreamResults, read_results
from fingerflow.schema.scene_tables import CalibrationSettings, ContactSizes
from fingerflow.schema.variables import CONTACT, DISPLACEMENT, FIELDS, FRAME_CHECK, LOADING, STREAM, TRACKING, by_name
from fingerflow.schema.views import Rectangle

_VARIABLES = by_name(FRAME_CHECK, LOADING, CONTACT, TRACKING, DISPLACEMENT, FIELDS, STREAM)
_TRACKED = 0  # value of `status` for a tracked point
# Fields that depend on the gauge length.
_WITH_GAUGE = "divergence", "divergence_std", "curl", "curl_std", "median_divergence", "median_curl", "median_strain"


def open_stream(folder: str | Path) -> xr.Dataset:
    """Return the results in the folder of a stream as an xarray data set, in the form that `process` returns.

    Variables have the names, dimensions, units, definitions and flags of :func:`fingerflow.process`, as far as a stream
    has them.

    Values at points are mapped from the file and read on access. The size of ``point`` is that of the largest set of
    seeded points: after a `restart`, the same index is another point. A stream that is still running, or was killed,
    gives its complete frames.

    Raises FingerflowError where it is no folder of results.
    """
    results = read_results(folder)
    try:
        restarts = [int(event["points"]) for event in results.events if event["event"] == "restart"]
        fields = results.header["recipe"].get("fields", {})
        gauge = {"gauge_length_mm": fields["gauge_length_mm"]} if fields else {}
        arrays = {
            name: (variable.dims, values, variable.attributes() | (gauge if name in _WITH_GAUGE else {}))
            for name, values in _values(results, restarts).items()
            if (variable := _VARIABLES.get(name)) is not None
        }
        time, frame = (np.array(results.records[name]) for name in ("time", "frame"))
        return labelled(arrays, time, frame, _about(results.header, _warnings(Path(folder) / "summary.json")))
    except KeyError as error:
        raise FingerflowError(f"{folder}: header.json does not state {error}; copy the folder again") from None


def _warnings(summary: Path) -> list[str]:
    """Return the warnings in the summary of a stream, which a stream that still runs or was killed has not."""
    try:
        return [str(line) for line in json.loads(summary.read_bytes() if summary.is_file() else "{}")["warnings"]]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return []


def _values(results: StreamResults, chosen: list[int]) -> dict[str, Array]:
    """Return all variables recorded in a stream, and others derived from them, as arrays by name; `chosen` lists the
    number of points at each reseeding.
    """
    records, header = results.records, results.header
    points = max(chosen, default=0)
    arrays: dict[str, Array] = {}
    for name in records.dtype.names or ():
        variable = _VARIABLES.get(name)
        if variable is not None:
            # Cut to the largest number of points found, as the records have space for more.
            arrays[name] = records[name][:, :points] if "point" in variable.dims else np.array(records[name])
    if "position_px" in arrays:
        known = {name: header[name] for name in ("mm_per_px", "topography_to_contact")} | header.get("lens", {})
        view = Rectangle(*(header["topography"][side] for side in ("rows", "columns"))) if "lens" in header else None
        arrays["position"] = Geometry(CalibrationSettings(**known), None, view).on_glass(arrays["position_px"])
    if "status" in arrays:
        tracked = arrays["status"] == _TRACKED
        of_restart = np.array([0, *chosen])[np.clip(arrays["restart"], 0, len(chosen))]
        with np.errstate(invalid="ignore", divide="ignore"):
            share = tracked.sum(1) / of_restart
        usable = records["frame_status"] == 0 if "frame_status" in arrays else True
        arrays["tracked_share"] = np.where(usable, share, np.nan)
        if "forward_backward_error" in arrays:
            arrays["forward_backward_median"] = _medians(np.where(tracked, arrays["forward_backward_error"], np.nan))
    for name, variable in _VARIABLES.items():
        if variable.formula is not None and name not in arrays and arrays.keys() >= set(variable.of):
            # A quotient with the divisor 0 is NaN or infinite, without a warning.
            with np.errstate(divide="ignore", invalid="ignore"):
                arrays[name] = variable.formula(*(arrays[source] for source in variable.of))
            if name == "real_contact_area_std":
                share = ContactSizes(header["recipe"]["contact"]["median_px"]).rounded_share(header["mm_per_px"])
                arrays[name] = np.hypot(arrays[name], share * arrays["real_contact_area"])
    return arrays


def _medians(values: Array) -> Array:
    """Return the median (F,) of the finite values in each row of an array (F, N); NaN for a row without any."""
    return np.array([np.median(row[np.isfinite(row)]) if np.isfinite(row).any() else np.nan for row in values])


def _about(header: dict[str, Any], warnings: list[str]) -> dict[str, Any]:
    return {
        "title": "fingertip on glass, a stream",
        "fingerflow_version": header["fingerflow"],
        "created": header["started"],
        "settings": json.dumps(header["recipe"]),
        "strain_measure": "green_lagrange",
        "warnings": json.dumps([*header["warnings"], *warnings]),
        "mm_per_px": header["mm_per_px"],
        "topography_to_contact": json.dumps(header["topography_to_contact"]),
        "frames": header["source"],
        "engine": header.get("engine") or header["provider"],
    }
