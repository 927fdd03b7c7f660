"""Time and error of tracking skin between two frames that moved by less than a pixel: this project and OpenCV.

Window 21 px, 700 corners (fewer with --quick), 8-bit frames of 512 x 640 px; the skin moved by (s, 0.7 s) for the shift
s. `start` says whether points lie on whole pixels, as corners of a keyframe do, or anywhere, as in tracking from frame
to frame. rms_px is over both coordinates of the accepted points; over_bound its ratio to the Cramer-Rao bound of the
window; bias_px the mean error, of the coordinate where it is larger, with its standard error. Rows "all" pool the
shifts (bias: the largest of them) and hold the time of a whole call, forward and backward, with its 10th to 90th
percentile.

- Without noise and shift both frames are identical and the error is exactly zero: the bound does not apply, and the
  pooled rows leave this case out. Without noise rounding is the only error, and it is not quite white.
- A ratio a little under 1 is no miracle: the splines reach two pixels beyond the window, so the tracker sees more than
  the 21 x 21 px of the bound.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from bench.drawing import BLUE, RED, Mark, cells, saved_axes
from bench.errors_of_tracks import error_cells, root_mean_square
from bench.rows import Cell, Row, number
from bench.skin import QUICK_SHAPE, SHAPE, choose_points, error_bound, photograph_pair
from bench.timing import time_in_turns
from bench.trackers import TRACKERS

WINDOW = 21


def run(quick: bool) -> list[Row]:
    """Return a row per noise, start, shift and tracker, and the pooled rows."""
    shape = QUICK_SHAPE if quick else SHAPE
    corners = choose_points(shape, 150 if quick else 700, WINDOW)
    anywhere = corners + torch.rand(corners.shape, generator=torch.Generator().manual_seed(0))
    rows: list[Row] = []
    for noise in (0, 2) if quick else (0, 1, 2, 5):
        for start, points in (("whole pixel", corners), ("anywhere", anywhere)):
            rows += _rows(shape, noise, start, points, quick)
    return rows


def _rows(shape: tuple[int, int], noise: int, start: str, points: Tensor, quick: bool) -> list[Row]:
    bound = error_bound(points, noise, WINDOW)
    single: dict[str, list[dict[str, Cell]]] = {name: [] for name in TRACKERS}
    for case, shift in enumerate((0.0, 0.3, 0.5) if quick else tuple(tenths / 10 for tenths in range(10))):
        motion = (shift, 0.7 * shift)
        previous, current = photograph_pair(shape, motion, noise, case)
        applies = noise > 0 or shift > 0
        for name, track in TRACKERS.items():
            found = track(previous, current, points, WINDOW)
            errors = (found.points - points - torch.tensor(motion))[0]
            cells = error_cells(errors, found.accepted, bound if applies else None)
            single[name].append({"noise": noise, "start": start, "shift": shift, "tracker": name, **cells})
    # Timed on the last pair, a typical one.
    times = time_in_turns(
        {name: partial(track, previous, current, points, WINDOW) for name, track in TRACKERS.items()},
        "opencv",
        rounds=3 if quick else 9,
    )
    pooled = [{**_pooled(single[name]), **times[name].cells()} for name in TRACKERS]
    one_by_one = [row for pair in zip(*single.values(), strict=True) for row in pair]
    return [*one_by_one, *pooled]


def _pooled(rows: list[dict[str, Cell]]) -> dict[str, Cell]:
    counted = [row for row in rows if row["over_bound"] is not None]
    biased = max(counted, key=lambda row: abs(number(row, "bias_px")))
    return {
        **biased,
        "shift": "all",
        "rms_px": root_mean_square([number(row, "rms_px") for row in counted]),
        "over_bound": root_mean_square([number(row, "over_bound") for row in counted]),
        "accepted": sum(number(row, "accepted") for row in counted) / len(counted),
    }


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw the error over the bound against the noise, by program and start."""
    noises = sorted({number(row, "noise") for row in rows})
    with saved_axes(path, 3.2, width=6) as (axes,):
        axes.axhline(1, color="0.65", linewidth=0.8, zorder=0)
        for name, tracker, colour in (("fingerflow", "fingerflow", RED), ("OpenCV", "opencv", BLUE)):
            for start in ("whole pixel", "anywhere"):
                found = cells(rows, "over_bound", "noise", noises, start=start, shift="all", tracker=tracker)
                axes.plot(noises, found, label=f"{name}, {start}", **Mark(colour, filled=start == "anywhere").style)
        axes.set(xlabel="noise (grey levels)", ylabel="RMS error / Cramér–Rao bound", xticks=noises)
        axes.legend(frameon=False)
