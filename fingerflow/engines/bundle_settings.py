"""Engine settings from the recipe of a deployment bundle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fingerflow.engines.engine import EngineSettings


def bundle_settings(recipe: Mapping[str, Any]) -> EngineSettings:
    """Return the engine settings with which the graphs of a bundle were exported.

    Args:
        recipe: that of bundle.json, with all its keys.
    """
    contact, tracking = recipe["contact"], recipe["tracking"]
    return EngineSettings(
        median_px=contact["median_px"],
        gross_radius_px=contact["gross_radius_px"],
        cell_px=contact["cell_px"],
        stride_px=contact["stride_px"],
        window_px=tracking["window_px"],
        gain_offset=tracking["gain_offset"],
        forward_backward_limit_px=tracking["forward_backward_limit_px"],
        search_px=tracking["search_px"],
        min_distance_px=tracking["min_distance_px"],
        gauge_length_mm=recipe["fields"]["gauge_length_mm"],
    )
