"""Faults of the gross contact area, in recordings and streams: steps from one frame to the next that no contact makes,
a contact that ends and begins again, and one that the edge of the view cuts off.

Areas are in mm^2 and forces in N, one value a frame from number `first_frame` on, NaN where there is none.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fingerflow.kernels.array_types import Numbers, Series
from fingerflow.tracker.frame_distances import LONGEST
from fingerflow.tracker.onset import LASTING

# Share of the largest area above which a recording begins in contact; ratio of growth that makes it a press.
_STARTS, _GROWS = 0.02, 1.1
# Change of the contact area between successive frames, as a share of the view's area, that no contact reaches.
_JUMP = 0.25
# Least step of the area in multiples of the neighbouring steps and as a share of the largest area; number of
# neighbouring frames on either side.
_MISSING, _LEAST_STEP, _BESIDE = 6.0, 0.02, 4
_TOUCHES = 0.02  # share of the largest area above which the finger touches
# Least share of the border of the contact at the edge of the view, and least area, mm², of which it is reported.
_CUT, _CUT_MM2 = 0.03, 1.0


def check_missing_frames(gross: Series, normal: Series | None, first_frame: int) -> Iterator[str]:
    """Yield a warning if the gross area jumps between two successive frames, as if frames were missing.

    A step of the force by as large a share is a real one.
    """
    step, largest = np.abs(np.diff(gross)), float(np.nanmax(gross, initial=0.0))
    if len(step) <= 2 * _BESIDE or not largest > 0:
        return
    around = np.lib.stride_tricks.sliding_window_view(step, 2 * _BESIDE + 1)
    usual = np.max([np.median(steps, axis=1) for steps in (around[:, :_BESIDE], around[:, _BESIDE + 1 :])], axis=0)
    touching = np.lib.stride_tricks.sliding_window_view(gross, 2 * _BESIDE + 2).min(1) > 0
    steps = step[_BESIDE:-_BESIDE]
    jumps = touching & (steps > _MISSING * usual) & (steps > _LEAST_STEP * largest)
    if normal is not None:
        by_force = np.abs(np.diff(normal))[_BESIDE:-_BESIDE] / max(float(np.nanmax(normal, initial=0.0)), 1e-9)
        jumps &= ~(by_force > steps / largest / 2)
    frames = np.flatnonzero(jumps) + _BESIDE
    if len(frames):
        frame = frames[0]
        yield (
            f"the gross contact area steps from {gross[frame]:.3g} to {gross[frame + 1]:.3g} mm² between frames "
            f"{frame + first_frame} and {frame + 1 + first_frame}, "
            f"{step[frame] / max(usual[frame - _BESIDE], 1e-9):.0f} times as far as in the frames around: frames may "
            f"be missing there, and all times after it be wrong, or a second contact merges with the first. Copy the "
            f"recording again, give one whose file has time stamps, or leave the other contact out by "
            f"views.contact.region"
        )


def check_beginning(gross: Series, first_frame: int) -> Iterator[str]:
    """Yield a warning if a recording, or a stream, begins when the finger already touches the glass."""
    measured = np.flatnonzero(np.isfinite(gross))
    first, largest = (gross[measured[0]], gross[measured].max()) if len(measured) else (0, 0)
    if first > _STARTS * largest and largest > _GROWS * first:
        yield (
            f"the recording begins in contact: {first:.3g} of {largest:.3g} mm² touch in frame "
            f"{measured[0] + first_frame}, and displacement there lacks what came before: begin earlier "
            "(recording.first_frame), or process it with fields.reference"
        )


def check_light_steps(gross: Series, view_area: float, first_frame: int) -> Iterator[str]:
    """Yield a warning if the gross area changes between two frames by a larger part of the view's area, mm^2, than that
    of any contact does.
    """
    measured = np.flatnonzero(np.isfinite(gross))
    far = np.abs(np.diff(gross[measured])) > _JUMP * view_area
    jumps = np.flatnonzero(far & (np.diff(measured) <= LONGEST + 1))
    if len(jumps):
        before, after = measured[jumps[0]], measured[jumps[0] + 1]
        yield (
            f"the gross contact area jumps from {gross[before]:.3g} to {gross[after]:.3g} mm² between frames "
            f"{before + first_frame} and {after + first_frame}: more likely the light has changed by more than can be "
            f"told from contact. Look at these frames; record the empty glass at that light, or leave them out by "
            f"recording.first_frame and last_frame"
        )


def second_touches(gross: Series) -> Numbers:
    """Return the indices (k,) of frames in which a contact begins again that had lasted and ended."""
    touching = np.flatnonzero(gross > _TOUCHES * np.nanmax(gross, initial=0.0))
    lifted = np.diff(np.cumsum(gross == 0)[touching]) > 0
    return touching[LASTING:][lifted[LASTING - 1 :]]


def cut_shares(margin: NDArray[np.floating], gross: Series) -> Series:
    """Return the shares (n,) of the border of the contact that lie at the edge of the view in n frames, about, by the
    cells that are positive in `margin` (n, rows, columns); 0 where the gross area (n,) mm^2 is small.
    """
    inside = margin > 0
    area = np.array([np.count_nonzero(cells) for cells in inside])  # many times as fast as a sum over two axes
    cut = inside[:, [0, -1]].sum((1, 2)) + inside[..., [0, -1]].sum((1, 2))
    return np.where(gross > _CUT_MM2, cut / np.maximum(2 * np.sqrt(np.pi * area), 1), 0)


def check_cut(share: float, frame: int) -> Iterator[str]:
    """Yield a warning if the edge of the view cuts off the contact: the largest `share` of its border that lies there,
    in a frame of this number.
    """
    if share > _CUT:
        yield (
            f"the edge of the contact view cuts off {share:.0%} of the border of the contact in frame {frame}: areas, "
            f"ellipse, medians and energy are of the rest. Make [views.contact] larger, or press in its middle"
        )
