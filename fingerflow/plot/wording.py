"""Words in figures for the tracked object of a result: skin and its points, or a gel and its markers."""

import json

import xarray as xr


def is_sensor(result: xr.Dataset) -> bool:
    """Return whether a result is of a soft sensor, whose markers were tracked."""
    kind: str = json.loads(result.attrs.get("settings", "{}")).get("kind", "press")
    return kind == "soft_sensor"


def followed(result: xr.Dataset) -> str:
    """Return the word for the tracked objects of a result: "markers" or "points"."""
    return "markers" if is_sensor(result) else "points"
