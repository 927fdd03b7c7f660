"""Plausibility checks of results and settings: warnings with a remedy."""

import numpy as np
from numpy.typing import NDArray

_NARROWEST_MM, _WIDEST_MM = 1.0, 100.0  # width of a view of skin: from a few ridges to a hand
_JUMP = 0.25  # share of the view's area: no contact grows by as much from one frame to the next
_FEW_FOUND, _FEW_TRACKED = 0.9, 0.5  # shares of the points, below which a warning is given
_POINTS_IN_GAUGE = 3.0  # least gauge length in mean point spacings: with less, a fit has hardly a neighbour
Series = NDArray[np.float64]


def of_scale(mm_per_px: float, shape: tuple[int, int]) -> list[str]:
    """Return a warning if the image scale makes a contact view of (rows, columns) px implausibly wide."""
    wide = mm_per_px * shape[1]
    if _NARROWEST_MM <= wide <= _WIDEST_MM:
        return []
    return [
        f"calibration.mm_per_px = {mm_per_px:g} makes the contact view {wide:.3g} mm wide, as no view of a fingertip "
        f"is: check the scale, or the radius of the ring's hole that it was measured by"
    ]


def of_frames(frames: int) -> list[str]:
    """Return a warning if only one frame is selected."""
    if frames > 1:
        return []
    return ["one frame: nothing has moved since, displacement, divergence and strain are 0 by definition"]


def of_areas(real: Series, gross: Series, view_area: float, radius_px: int, first_frame: int) -> list[str]:
    """Return warnings for contact areas (frames,) mm^2, NaN if unusable: real area above gross area, or jumps of the
    latter.

    `view_area` is the area of the view, mm^2.
    """
    said = []
    more = np.flatnonzero((real > gross) & (gross > 0))
    if len(more):
        frame = more[0]
        said.append(
            f"in {len(more)} frames, the first is {frame + first_frame}, the real contact area is larger than the "
            f"gross one ({real[frame]:.3g} and {gross[frame]:.3g} mm2), of which it is a part: "
            f"contact.gross_radius_px = {radius_px} is less than half the distance between ridges"
        )
    known = np.flatnonzero(np.isfinite(gross))
    jumps = np.flatnonzero(np.abs(np.diff(gross[known])) > _JUMP * view_area)
    if len(jumps):
        before, after = known[jumps[0]], known[jumps[0] + 1]
        said.append(
            f"the gross contact area jumps from {gross[before]:.3g} to {gross[after]:.3g} mm2 between frames "
            f"{before + first_frame} and {after + first_frame}: more likely the light has changed by more than can be "
            f"told from contact. Look at these frames; record the empty glass at that light, or leave them out by "
            f"recording.first_frame and last_frame"
        )
    return said


def of_points(found: int, asked: int, min_distance_px: float, region_px: int) -> list[str]:
    """Return a warning if far fewer points were seeded than requested, in a region of `region_px` pixels."""
    if found >= _FEW_FOUND * asked:
        return []
    # Upper bound of the number of points: one in each square of side `min_distance_px`.
    room = round(region_px / min_distance_px**2)
    if room < asked:
        why = (
            f"the region of {region_px} px has room for some {room} that lie {min_distance_px:g} px apart. Lower "
            f"tracking.min_distance_px, ask for fewer in tracking.points, or make the region larger"
        )
    else:
        why = (
            f"the region of {region_px} px has room for {room}, but no more corners stand out of the noise. Check "
            f"focus and light, or ask for fewer in tracking.points"
        )
    return [f"{found} of {asked} points were found: {why}"]


def of_tracking(share: Series, first_frame: int) -> list[str]:
    """Return a warning for frames whose share (frames,) of tracked points is low; a share is NaN without points."""
    few = np.flatnonzero(share < _FEW_TRACKED)
    if not len(few):
        return []
    return [
        f"less than half of the points are tracked in {len(few)} frames, the first is {few[0] + first_frame} "
        f"({share[few[0]]:.0%}): what is known there is of the rest alone. status says why each was lost"
    ]


def of_windows(share: Series, first_frame: int) -> list[str]:
    """Return a warning for points whose window no longer matches the window in which they were seeded.

    `share` (frames,) is their share of the points, NaN without points.
    """
    some = np.flatnonzero(share > 0)
    if not len(some):
        return []
    return [
        f"points were followed to where their window differs from that in which they were seeded, in {len(some)} "
        f"frames, the first is {some[0] + first_frame}, up to {np.max(share[some]):.1%} of them: their positions are "
        f"NaN there (status window_differs)"
    ]


def of_gauge(gauge_mm: float, points: NDArray[np.floating], contact_mm: float) -> list[str]:
    """Return warnings if the gauge length is too short for the point spacing or longer than the contact is wide.

    `points` (N, 2) mm are positions at first contact, NaN for points never in contact; `contact_mm` is the least
    diameter of the largest contact.
    """
    known = points[np.isfinite(points).all(1)]
    if not np.isfinite(contact_mm):
        return []
    if len(known) < 3:
        return [
            f"{len(known)} of {len(points)} points come into contact: no gradient can be fitted. Ask for more points"
        ]
    spread = np.sqrt(np.prod(np.ptp(known, axis=0)) / len(known))
    if gauge_mm < _POINTS_IN_GAUGE * spread:
        return [
            f"fields.gauge_length_mm = {gauge_mm:g}, and {len(known)} points lie some {spread:.2g} mm apart: a "
            f"gradient has few neighbours or none. Take {_POINTS_IN_GAUGE * spread:.2g} mm or more, or more points"
        ]
    if gauge_mm > contact_mm:
        return [
            f"fields.gauge_length_mm = {gauge_mm:g} is more than the contact is wide ({contact_mm:.2g} mm): "
            f"divergence, curl and strain are smoothed over all of it"
        ]
    return []
