"""Outlines of the contact and of the stick region in one frame, in mm on the glass."""

import math

import cv2
import numpy as np
import xarray as xr
from numpy.typing import NDArray

_TURNS = np.linspace(0, 2 * np.pi, 120, endpoint=False)


def contact_outline(frame: xr.Dataset) -> NDArray[np.float64] | None:
    """Return points (K, 2) on the ellipse of the gross contact, mm; None without contact."""
    known = all(name in frame for name in ("ellipse_center", "ellipse_semi_axes", "ellipse_angle"))
    if not known or not np.isfinite(frame["ellipse_center"]).all():
        return None
    along, across = np.asarray(frame["ellipse_semi_axes"])[:, None] * np.stack((np.cos(_TURNS), np.sin(_TURNS)))
    cosine, sine = math.cos(frame["ellipse_angle"]), math.sin(frame["ellipse_angle"])
    outline: NDArray[np.float64] = np.stack((along * cosine - across * sine, along * sine + across * cosine), 1)
    result: NDArray[np.float64] = outline + np.asarray(frame["ellipse_center"])
    return result


def stuck_outline(region: NDArray[np.integer], cell_mm: float, first_cell_mm: float) -> NDArray[np.float64] | None:
    """Return the longest outline (K, 2) of the stick region, mm, through centres of its cells; None without any."""
    contours, _ = cv2.findContours(np.asarray(region, dtype=np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return None
    longest = max(contours, key=len)[:, 0]
    return np.asarray(longest * cell_mm + first_cell_mm, dtype=np.float64)
