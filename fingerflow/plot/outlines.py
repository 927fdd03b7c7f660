"""Outlines of contact and stick region in one frame, in mm on the glass or in px of a view."""

import json
import math

import cv2
import numpy as np
import xarray as xr
from numpy.typing import NDArray

Values = NDArray[np.float64]
_TURNS = np.linspace(0, 2 * np.pi, 120, endpoint=False)


def contact_outline(frame: xr.Dataset) -> Values | None:
    """Return K points (K, 2) mm on the ellipse around the apparent contact; None without contact."""
    has_ellipse = all(name in frame for name in ("ellipse_center", "ellipse_semi_axes", "ellipse_angle"))
    if not has_ellipse or not np.isfinite(frame["ellipse_center"]).all():
        return None
    along, across = np.asarray(frame["ellipse_semi_axes"])[:, None] * np.stack((np.cos(_TURNS), np.sin(_TURNS)))
    cosine, sine = math.cos(frame["ellipse_angle"]), math.sin(frame["ellipse_angle"])
    outline = np.stack((along * cosine - across * sine, along * sine + across * cosine), 1)
    return outline + np.asarray(frame["ellipse_center"])


def stuck_outline(frame: xr.Dataset) -> Values | None:
    """Return the longest outline (K, 2) mm of the stick region, through grid-cell centres; None without one."""
    if "stuck_region" not in frame:
        return None
    region = frame["stuck_region"]
    contours, _ = cv2.findContours(np.asarray(region, dtype=np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return None
    longest = max(contours, key=len)[:, 0]
    return np.asarray(longest * region.attrs["cell_mm"] + region.attrs["first_cell_mm"], dtype=np.float64)


def matrix_of_view(result: xr.Dataset, view: str) -> Values:
    """Return the affine map (2, 3) from mm on the glass to px of a view."""
    matrix = np.diag([1 / float(result.attrs["mm_per_px"])] * 2 + [1.0])
    if view == "topography":
        onto = np.vstack((np.array(json.loads(result.attrs["topography_to_contact"])), (0, 0, 1)))
        matrix = np.linalg.inv(onto) @ matrix
    return matrix[:2]


def to_pixels(millimetres: Values, matrix: Values) -> Values:
    """Convert positions (N, 2) from mm on the glass to px of a view."""
    return millimetres @ matrix[:, :2].T + matrix[:, 2]
