"""What a result is of, in words: skin and its points, or a gel and its markers."""

import json

import xarray as xr


def is_sensor(result: xr.Dataset) -> bool:
    """Whether markers of a soft sensor were followed."""
    kind: str = json.loads(result.attrs.get("settings", "{}")).get("kind", "press")
    return kind == "soft_sensor"


def followed(result: xr.Dataset) -> str:
    """What was followed: "markers" or "points"."""
    return "markers" if is_sensor(result) else "points"
