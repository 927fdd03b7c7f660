"""Errors of `process` on skins like fingerprints, against the exact truth, and where pictures of real fingers are.

- gross_10 and gross_40: gross area in percent, mean over every third frame with `middle` to `large` mm² and from
  `large` mm² on; worst: the largest of either, with its sign;
- angle_deg: of the ellipse, RMS from `large` mm² on; axes: percent, RMS from `middle` mm² on;
- onset and onset_rms: frame of onset minus the true one, mean and RMS over the points, but those of the first 5 mm²;
- real: real area in percent, RMS from `middle` mm² on; position_px: RMS in the last frame, points that are not lost;
- divergence_um_mm: median over the contact, RMS from `middle` mm² on.

- Real prints are those of FVC2002 DB2 (569 dpi) in a folder `shared/data/fingers` beside the checkout. They are no part
  of this project.
- Gross truth is the ellipse in which skin may touch. Where a valley or a gap of the skin lies on it, nothing shows it.
"""

from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fingerflow.synthetic import SyntheticScene

FINGERS = Path(__file__).resolve().parents[2] / "shared" / "data" / "fingers"
PRINTS = ("101_1", "101_2", "101_3", "104_1")
DPI = 569.0
OUTPUTS = [
    "gross_contact_area",
    "real_contact_area",
    "ellipse_semi_axes",
    "ellipse_angle",
    "onset_frame",
    "position_px",
    "median_divergence",
]

Array = NDArray[np.float64]


def errors(
    result: xr.Dataset, scene: SyntheticScene, middle: float = 10.0, large: float = 40.0
) -> dict[str, float | None]:
    """Return the error columns of a result of a scene; None where no frame counts.

    Args:
        middle, large: gross areas in mm² from which frames count in the one column and in the other.
    """
    truth = scene.truth
    area = np.array([truth.gross_contact_area_mm2(k) for k in range(scene.n_frames)])
    from_middle = np.flatnonzero(area > middle)[::3]
    from_large = from_middle[area[from_middle] > large]
    gross = 100 * (result["gross_contact_area"].values / np.where(area > 0, area, np.nan) - 1)
    real_area = np.array([truth.real_contact_area_mm2(k) for k in from_middle])
    real = 100 * (result["real_contact_area"].values[from_middle] / real_area - 1)
    ellipses = [truth.ellipse(k) for k in from_middle]
    true_axes = np.array([ellipse.semi_axes for ellipse in ellipses if ellipse is not None])
    angle = np.array([ellipse.angle for ellipse in ellipses if ellipse is not None])
    axes = 100 * (result["ellipse_semi_axes"].values[from_middle] / true_axes - 1)
    turn = result["ellipse_angle"].values[from_middle] - angle
    turn = np.degrees(np.arctan(np.tan(turn)))[area[from_middle] > large]
    divergence = 1000 * (
        result["median_divergence"].values[from_middle] - [truth.medians(k).divergence for k in from_middle]
    )
    onset, distance = _at_points(result, scene, area)
    below = from_middle[area[from_middle] <= large]
    return {
        "gross_10": _mean(gross[below]),
        "gross_40": _mean(gross[from_large]),
        "worst": float(gross[from_middle][np.argmax(np.abs(gross[from_middle]))]),
        "angle_deg": _rms(turn),
        "axes": _rms(axes),
        "onset": _mean(onset),
        "onset_rms": _rms(onset),
        "real": _rms(real),
        "position_px": _rms(distance),
        "divergence_um_mm": _rms(divergence),
    }


def _at_points(result: xr.Dataset, scene: SyntheticScene, area: Array) -> tuple[Array, Array]:
    """Return errors of the onset (frames) where points touch late enough, and distances (px) from true positions."""
    truth, last = scene.truth, scene.n_frames - 1
    pixels = result["position_px"].values
    material = truth.material(truth.topography_positions(pixels[0]), 0)
    distance = np.linalg.norm(pixels[-1] - truth.topography_pixels(truth.positions(material, last)), axis=-1)
    true_onset, onset = truth.onset_frame(material), result["onset_frame"].values
    late = (true_onset > 0) & (onset > 0) & (area[np.maximum(true_onset, 0)] > 5)
    return (onset - true_onset)[late].astype(np.float64), distance[np.isfinite(distance)]


def _mean(values: Array) -> float | None:
    return float(np.mean(values)) if values.size else None


def _rms(values: Array) -> float | None:
    return float(np.sqrt(np.nanmean(np.square(values)))) if values.size else None
