"""Table of a trial's main quantities, with uncertainty, at the frames that its report shows in detail."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from fingerflow.report.key_frames import KeyFrame
from fingerflow.schema.rounding import format_uncertainty
from fingerflow.schema.variables import VARIABLES

QUANTITIES = (
    "normal_force", "tangential_force", "load_ratio", "gross_contact_area", "real_contact_area", "contact_area_ratio",
    "stuck_ratio", "printed_stuck_ratio", "median_divergence", "median_curl", "global_displacement", "strain_energy",
)  # fmt: skip


def key_numbers(result: xr.Dataset, frames: Sequence[KeyFrame]) -> list[tuple[str, str, list[str]]]:
    """Return the rows of the table of key numbers, one per quantity (time, force, areas, divergence, energy and
    others): its name, its unit, and its value at each of the key frames `frames` ± one standard deviation as text.

    A quantity without a standard deviation is shown without.
    """
    indices = [frame for frame, _ in frames]
    rows = [("time", "s", [f"{value:.3f}" for value in result["time"].values[indices]])]
    for name in QUANTITIES:
        if name not in result or not np.isfinite(result[name].values).any():
            continue
        variable, values = VARIABLES[name], result[name].values
        spread = result[f"{name}_std"].values if f"{name}_std" in result else np.full(len(values), np.nan)
        pairs = variable.shown_values(np.stack((values, spread), axis=1)[indices]).tolist()
        rows.append((variable.words, variable.shown_unit.name, [format_uncertainty(*pair) for pair in pairs]))
    return rows
