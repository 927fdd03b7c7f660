"""Comparison of measurements with the truth of a synthetic scene."""

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fingerflow.ops.tracking.track_points import TrackStatus
from fingerflow.synthetic import SyntheticScene

Array = NDArray[np.float64]


class Comparison(NamedTuple):
    """One quantity: measured and true value in the last frame, and a text with its errors."""

    quantity: str
    unit: str
    measured: float
    truth: float
    error: str


def compare(result: xr.Dataset, scene: SyntheticScene) -> list[Comparison]:
    """Compare every quantity of a completely processed synthetic recording with the truth.

    Early contact is smaller than the structures it is made of: errors of areas are given from 10 mm² on.
    """
    truth = scene.truth
    last = scene.n_frames - 1
    rows = []

    def relative(quantity: str, unit: str, values: Array, true: Array, large: NDArray[np.bool_]) -> None:
        error = np.abs(values[large] / true[large] - 1)
        text = f"{error[-1]:.2%} (worst frame over 10 mm²: {error.max():.2%})"
        rows.append(Comparison(quantity, unit, values[last], true[last], text))

    gross = np.array([truth.gross_contact_area_mm2(i) for i in range(scene.n_frames)])
    large = gross > 10
    looked = np.flatnonzero(large)[:: max(1, large.sum() // 30)]
    some = np.zeros_like(large)
    some[[*looked, last]] = True
    real = np.array([truth.real_contact_area_mm2(i) if some[i] else np.nan for i in range(scene.n_frames)])
    relative("real contact area", "mm²", result["real_contact_area"].values, real, some)
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
    rows.append(Comparison("position of a point, last frame", "px", root_mean_square, 0.0, text))
    if "median_divergence" not in result:
        return rows
    frames = [*looked[::2], last]
    since = result["median_divergence"].attrs.get("reference_frame")
    medians = {i: truth.medians(i, reference=since) for i in frames}
    true = float(np.hypot(medians[last].displacement_x, medians[last].displacement_y))
    measured = float(result["global_displacement"].values[last])
    rows.append(Comparison("global displacement", "mm", measured, true, f"{measured - true:+.4f} mm"))
    strain = result["median_strain"].values.T
    series = result["median_divergence"].values, result["median_curl"].values, *strain
    for quantity, values in zip(("divergence", "curl", "strain exx", "strain eyy", "strain exy"), series, strict=True):
        exact = np.array([getattr(medians[i], quantity.split()[-1]) for i in frames])
        error = 1000 * (values[frames] - exact)
        text = f"{error[-1]:+.2f} (worst frame: {error[np.nanargmax(np.abs(error))]:+.2f})"
        rows.append(
            Comparison(f"median {quantity}", "µm/mm", 1000 * float(values[last]), 1000 * float(exact[-1]), text)
        )
    return rows


def as_text(rows: list[Comparison]) -> str:
    """Return the table in plain text."""
    lines = [f"{'quantity':33}{'measured':>12}{'truth':>12}  {'unit':7}error"]
    lines += [f"{row.quantity:33}{row.measured:12.4f}{row.truth:12.4f}  {row.unit:7}{row.error}" for row in rows]
    return "\n".join(lines)
