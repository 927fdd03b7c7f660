"""Error of the measured divergence of the skin-chain model, rendered to images and measured by `fingerflow.process`.

A press of 5 N to a contact of 30 mm², the paper's chain turned about its axis, 96 frames of two 512 x 640 px views at
100 a second (60 of 288 x 288 px with --quick), noise of 2 grey levels, default settings (gauge length 1.6 mm). All
divergences are those of the displacement since each point's onset, du/dxi + u/xi, in um/mm; those of the chain are
differences between its elements (`models.skin_onset`), without splines or pictures.

- inner: mean over the disc of 0.6 of the contact's radius, as measured in the last frame; inner_chain: the chain's;
  inner_rms, inner_worst: error over the frames from 5 mm² on;
- median, median_chain, median_rms, median_worst: the same of `median_divergence`, over the area of the gross contact,
  from 3 mm² on. The median lies where the field falls steeply: what the edge is off weighs in it.
- radial_um: largest error of a radial displacement, mean over rings of an eighth of the radius. At mu = 0.05 the field
  changes by 40 um/mm within a mm: windows of 0.8 mm and a gauge of 1.6 mm do not follow that.
"""

from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bench.recordings import processed
from bench.rows import Row
from fingerflow.models.skin_onset import since_onset
from fingerflow.synthetic import ChainPress

FRICTIONS = (0.05, 0.2, 1.0)
PRESS = ChainPress(n_frames=96, frame_rate=100.0, frames_before_trigger=4)
QUICK_PRESS = ChainPress(n_frames=60, frame_rate=60.0, frames_before_trigger=3, frame_shape=(288, 576))

INNER = 0.6  # share of the contact's radius; the divergence within depends little on the detected edge
Array = NDArray[np.float64]


def run(quick: bool) -> list[Row]:
    """Return a row per friction."""
    return [_row(replace(QUICK_PRESS if quick else PRESS, friction=friction)) for friction in FRICTIONS]


def inner_divergence(press: ChainPress, result: xr.Dataset) -> tuple[Array, Array]:
    """Return the mean divergence (F,) um/mm over the disc of 0.6 of the contact's radius, measured and of the chain.

    The measured one is NaN where the contact is under 5 mm².
    """
    chain = 1e3 * press.interpolate_chain(since_onset(press.chain).mean_within(INNER))
    large = np.nan_to_num(result["gross_contact_area"].values) > 5
    return np.where(large, _measured_inner(result), np.nan), chain


def median_divergence(press: ChainPress, result: xr.Dataset) -> tuple[Array, Array]:
    """Return the median divergence (F,) um/mm over the contact, measured and of the chain.

    The measured one is NaN where the contact is under 3 mm².
    """
    seen = since_onset(press.chain)
    large = press.interpolate_chain(seen.contact_area) > 3e-6
    return np.where(large, 1e3 * result["median_divergence"].values, np.nan), 1e3 * press.interpolate_chain(
        seen.area_median
    )


def _row(press: ChainPress) -> Row:
    result = processed(press)
    row: dict[str, float] = {"friction": press.friction}
    for name, (measured, chain) in (
        ("inner", inner_divergence(press, result)),
        ("median", median_divergence(press, result)),
    ):
        error = measured - chain
        row |= {
            name: float(measured[-1]),
            f"{name}_chain": float(chain[-1]),
            f"{name}_rms": float(np.sqrt(np.nanmean(error**2))),
            f"{name}_worst": float(np.nanmax(np.abs(error))),
        }
    return row | {"radial_um": _radial_error(press, result)}


def _measured_inner(result: xr.Dataset) -> Array:
    """Return for each frame the mean divergence, um/mm, of the tracked points within 0.6 of the contact ellipse's
    radius from its centre; NaN without such points.
    """
    found = np.full(result.sizes["frame"], np.nan)
    for frame in range(len(found)):
        (first, second), angle = result["ellipse_semi_axes"].values[frame], result["ellipse_angle"].values[frame]
        right, down = (result["position"].values[frame] - result["ellipse_center"].values[frame]).T
        along, across = np.cos(angle) * right + np.sin(angle) * down, np.cos(angle) * down - np.sin(angle) * right
        values = result["divergence"].values[frame][np.hypot(along / first, across / second) < INNER]
        values = values[np.isfinite(values)]
        found[frame] = 1e3 * values.mean() if len(values) else np.nan
    return found


def _radial_error(press: ChainPress, result: xr.Dataset) -> float:
    truth, last = press.truth, press.n_frames - 1
    material = truth.material(truth.topography_positions(result["position_px"].values[0]), 0)
    outward = material - press.contact_centre
    radius = np.hypot(*outward.T)
    off = result["position"].values[last] - truth.positions(material, last)
    error = 1e3 * (off * outward).sum(-1) / radius
    ellipse = truth.ellipse(last)
    assert ellipse is not None
    ring = np.floor(8 * radius / ellipse.semi_axes[0])
    return max(abs(float(np.nanmean(error[ring == k]))) for k in range(8))
