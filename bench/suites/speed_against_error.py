"""Time of a tracked point against its error at a noise of 2 grey levels, for several windows.

Skin of 512 x 640 px and 700 points (fewer with --quick), anywhere within a pixel, moved by 0.1, 0.35, 0.6 and 0.85 px
(and 0.7 of it in y). us_per_point is one call for all points over their number, forward and backward, pyramids and
spline coefficients included, and time_to_peer is over OpenCV's with 1 level at 21 px; over_bound is the RMS error over
the Cramer-Rao bound of the same window. A larger window has a smaller bound: compare rms_px across windows. Points that
are accepted and lie more than 0.5 px off are left out of both, since a few of them would hide all the others; `wrong`
is their share of all points. The figure is drawn from these rows.

- The splines reach two pixels beyond the window, so a small window sees clearly more than its bound allows for.
- Nothing deforms here, so two passes buy nothing: what they cost is shown.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import matplotlib.pyplot as plt
import torch
from matplotlib import patheffects

from bench.errors_of_tracks import error_cells
from bench.rows import Row, number
from bench.skin import QUICK_SHAPE, SHAPE, choose_points, clean_picture, error_bound, photograph
from bench.timing import time_in_turns
from bench.trackers import Tracker, track_fingerflow, track_opencv

NOISE = 2
WINDOWS = (11, 15, 21, 25, 31)
SHIFTS = (0.1, 0.35, 0.6, 0.85)
TRACKERS: dict[str, Tracker] = {
    "fingerflow": track_fingerflow,
    "fingerflow, two passes": partial(track_fingerflow, passes=2),
    "OpenCV, 1 level": partial(track_opencv, levels=0),
    "OpenCV, 4 levels": partial(track_opencv, levels=3),
}
PEER = "OpenCV, 1 level, 21 px"
WRONG = 0.5  # px


def run(quick: bool) -> list[Row]:
    """One row a window and tracker."""
    shape = QUICK_SHAPE if quick else SHAPE
    corners = choose_points(shape, 150 if quick else 700, border=18)
    points = corners + torch.rand(corners.shape, generator=torch.Generator().manual_seed(0))
    motions = [(shift, 0.7 * shift) for shift in SHIFTS]
    previous = [photograph(clean_picture(shape, (0.0, 0.0)), NOISE, seed=2 * n) for n in range(len(motions))]
    current = [photograph(clean_picture(shape, m), NOISE, seed=2 * n + 1) for n, m in enumerate(motions)]
    windows = (15, 21) if quick else WINDOWS
    # All in one round, so that the windows can be compared with each other.
    calls = {
        f"{name}, {window} px": partial(track, previous[1], current[1], points, window)
        for window in windows
        for name, track in TRACKERS.items()
    }
    times = time_in_turns(calls, PEER, rounds=2 if quick else 9)
    rows: list[Row] = []
    for window in windows:
        bound = error_bound(points, NOISE, window)
        for name, track in TRACKERS.items():
            found = [track(*pair, points, window) for pair in zip(previous, current, strict=True)]
            errors = torch.stack(
                [(f.points - points - torch.tensor(m))[0] for f, m in zip(found, motions, strict=True)]
            )
            accepted = torch.stack([f.accepted for f in found])
            wrong = accepted & (errors.norm(dim=-1) > WRONG)
            cells = error_cells(errors.flatten(0, 1), (accepted & ~wrong).flatten(), bound.repeat(len(motions), 1, 1))
            timing = times[f"{name}, {window} px"]
            rows.append(
                {
                    "window_px": window,
                    "tracker": name,
                    "rms_px": cells["rms_px"],
                    "over_bound": cells["over_bound"],
                    "accepted": accepted.double().mean().item(),
                    "wrong": wrong.double().mean().item(),
                    "us_per_point": 1e3 * timing.median_ms / points.shape[1],
                    **timing.cells(),
                }
            )
    return rows


# Colour for the project, filling for the variant, and where the windows' numbers stand, in points from their markers.
_STYLES = {
    "fingerflow": ("#b5402a", "#b5402a", "o", (0, -12)),
    "fingerflow, two passes": ("#b5402a", "white", "o", (-11, 0)),
    "OpenCV, 1 level": ("#2b5c8a", "#2b5c8a", "s", (0, 11)),
    "OpenCV, 4 levels": ("#2b5c8a", "white", "s", (0, 11)),
}
_HALO = [patheffects.withStroke(linewidth=2.5, foreground="white")]


def draw(rows: Sequence[Row], path: Path) -> None:
    """Time of a point against its error over the bound, one line a tracker, one marker a window."""
    figure, axes = plt.subplots(figsize=(7.4, 4.6), dpi=200, layout="constrained")
    axes.axhline(1, color="0.65", linewidth=0.8, zorder=0)
    for name, (colour, filling, marker, (right, up)) in _STYLES.items():
        mine = [row for row in rows if row["tracker"] == name]
        times, errors = ([number(row, column) for row in mine] for column in ("us_per_point", "over_bound"))
        axes.plot(times, errors, color=colour, marker=marker, markerfacecolor=filling, markersize=6, linewidth=1.2)
        for time, error, row in zip(times, errors, mine, strict=True):
            # OpenCV's times at 21 and 25 px are nearly the same: the larger windows above, the others below.
            below = number(row, "window_px") <= 21 and up > 0
            axes.annotate(
                str(row["window_px"]),
                (time, error),
                (right, -up if below else up),
                textcoords="offset points",
                ha="center",
                va="center",
                fontsize=8,
                color=colour,
                path_effects=_HALO,
            )
        lost = 1 - sum(number(row, "accepted") for row in mine) / len(mine)
        label = f"{name}\n({lost:.0%} of the points lost)" if lost > 0.005 else name
        axes.annotate(label, (times[-1], errors[-1]), (9, -3), textcoords="offset points", fontsize=9, color=colour)
    axes.set_xscale("log")
    axes.set_xticks([5, 10, 20, 50, 100, 200], ["5", "10", "20", "50", "100", "200"])
    axes.minorticks_off()
    axes.set_ylim(0.85, max(number(row, "over_bound") for row in rows) + 0.02)  # room for the labels
    threads = torch.get_num_threads()
    axes.set_xlabel(f"time per point, there and back, {threads} thread{'s' * (threads > 1)} (µs)")
    axes.set_ylabel("RMS error / Cramér–Rao bound")
    axes.set_title(
        f"Tracking 700 points of skin at a noise of {NOISE} grey levels; numbers are windows in px",
        loc="left",
        fontsize=10,
    )
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path)
    plt.close(figure)
