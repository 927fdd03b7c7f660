"""Comparison of pipeline results with the ground truth of a synthetic scene."""

from dataclasses import astuple
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fingerflow.ops.tracking.track_points import TrackStatus
from fingerflow.schema.variables import VARIABLES
from fingerflow.synthetic import SyntheticScene
from fingerflow.synthetic.frame_threads import each_frame

Array = NDArray[np.float64]


# Comparison of one measured quantity with the truth: quantity, unit, measured and truth, both in the last frame, and a
# text with the error.
Comparison = dict[str, Any]


def compare(result: xr.Dataset, scene: SyntheticScene) -> list[Comparison]:
    """Compare every quantity of a completely processed synthetic recording with the truth.

    Early contact is smaller than the structures it is made of: errors of areas are given from 10 mm² on.
    """
    truth = scene.truth
    last = scene.n_frames - 1
    rows: list[Comparison] = []

    def add(quantity: str, unit: str, measured: float, true: float, error: str) -> None:
        rows.append({"quantity": quantity, "unit": unit, "measured": measured, "truth": true, "error": error})

    def relative(quantity: str, unit: str, values: Array, true: Array, large: NDArray[np.bool_]) -> None:
        error = np.abs(values[large] / true[large] - 1)
        text = f"{error[-1]:.2%} (worst frame over 10 mm²: {error.max():.2%})"
        add(quantity, unit, values[last], true[last], text)

    gross = np.array([truth.gross_contact_area_mm2(i) for i in range(scene.n_frames)])
    large = gross > 10
    looked = np.flatnonzero(large)[:: max(1, large.sum() // 30)]
    checked = np.unique([*looked, last])
    real = np.full(scene.n_frames, np.nan)
    real[checked] = list(each_frame(truth.real_contact_area_mm2, checked.tolist()))
    relative("real contact area", "mm²", result["real_contact_area"].values, real, checked)
    relative("gross contact area", "mm²", result["gross_contact_area"].values, gross, large)
    ellipses = [truth.ellipse(i) for i in range(scene.n_frames)]
    axes = np.array(
        [(np.nan, np.nan) if ellipse is None else sorted(ellipse.semi_axes, reverse=True) for ellipse in ellipses]
    )
    for k, name in enumerate(("semi-major axis", "semi-minor axis")):
        relative(name, "mm", result["ellipse_semi_axes"].values[:, k], axes[:, k], large)
    if "position_px" not in result:
        return rows

    pixels = result["position_px"].values
    tracked = result["status"].values[last] == TrackStatus.TRACKED
    distance = np.linalg.norm(pixels[last] - truth.follow(pixels[0], 0, last), axis=-1)[tracked]
    root_mean_square = float(np.sqrt((distance**2).mean()))
    text = f"{root_mean_square:.4f} RMS, {distance.max():.3f} worst"
    add("position of a point, last frame", "px", root_mean_square, 0.0, text)
    if "median_divergence" not in result:
        return rows
    frames = [*looked[::2], last]
    since = result["median_divergence"].attrs.get("reference_frame")
    medians = each_frame(lambda frame: astuple(truth.medians(frame, reference=since)), frames)
    divergence, curl, *strains, x, y = np.array(list(medians)).T
    strain = result["median_strain"].values.T
    for name, component, measured, true in (
        ("global_displacement", "", result["global_displacement"].values, np.hypot(x, y)),
        ("median_divergence", "", result["median_divergence"].values, divergence),
        ("median_curl", "", result["median_curl"].values, curl),
        *(("median_strain", *row) for row in zip((" exx", " eyy", " exy"), strain, strains, strict=True)),
    ):
        variable = VARIABLES[name]
        computed, expected = variable.shown_values(measured[frames]), variable.shown_values(true)
        error = computed - expected
        text = f"{error[-1]:+.3g} (worst frame: {error[np.nanargmax(np.abs(error))]:+.3g})"
        name, unit = f"{variable.words}{component}", variable.shown_unit.name
        add(name, unit, float(computed[-1]), float(expected[-1]), text)
    return rows


def as_text(rows: list[Comparison]) -> str:
    """Return the comparisons of measured with true values as a table in plain text, with one row per quantity."""
    lines = [f"{'quantity':33}{'measured':>12}{'truth':>12}  {'unit':7}error"]
    lines += ["{quantity:33}{measured:12.4f}{truth:12.4f}  {unit:7}{error}".format(**row) for row in rows]
    return "\n".join(lines)
