"""Time per tracked point against tracking error, for image pairs, recordings and streams with noise of 2 grey levels.

Skin of 512 x 640 px and 700 points (fewer with --quick), anywhere within a pixel. us_per_point is one call for all
points over points and frames (of one thread the processor's time), and time_to_peer is over OpenCV's with 1 level at
21 px. over_bound is the RMS error over the Cramer-Rao bound of the same window: a larger window has a smaller bound,
compare rms_px across windows. Points that are accepted and lie more than 0.5 px off are left out of both, since a few
of them would hide all the others; `wrong` is their share of all points. The figure is drawn from these rows.

*A pair* moves by 0.1, 0.35, 0.6 and 0.85 px (and 0.7 of it in y), and nothing of it is known before: forward and
backward, pyramids and spline coefficients included.

- fingerflow: `track_points`. The splines reach two pixels beyond the window, so a small window sees clearly more than
  its bound allows for. Nothing deforms here, so two passes buy nothing: what they cost is shown.
- OpenCV: Lucas-Kanade with 1 and 4 levels of the pyramid.
- kornia has no tracker of points: `bench.kornia_tracker` registers the windows of 100 of them by gradient descent.
- Two DIC codes, measured apart by `bench.dic_codes` at 21 px, on a grid, one way, with the threads and on the date that
  `remark` says.

*Recorded* and *live* are frames that follow each other: templates were prepared in a key frame, and `Engine.follow` of
the compiled library finds them there and back, eight frames or one a call. The windows are those of the recipes exact
(25 px, the default) and fast (11 px); points are the same for both. The picture moves on by 0.2 px a frame and faster
by 0.02 px every frame, so that points lie 0.01 to 0.04 px off their predictions, beside the noise of these. Contact,
correction for the deformation and fields are not part of it.
"""

import json
import tomllib
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import torch
from matplotlib import patheffects
from torch import Tensor

from bench import dic_codes
from bench.drawing import BLUE, GREEN, RED, VIOLET
from bench.environment import describe
from bench.errors_of_tracks import error_cells
from bench.kornia_tracker import track_kornia
from bench.rows import Row, number
from bench.skin import QUICK_SHAPE, SHAPE, choose_points, clean_picture, error_bound, photograph, photograph_pair
from bench.timing import Timing, time_in_turns
from bench.trackers import Found, Tracker, follow_fingerflow, track_fingerflow, track_opencv
from fingerflow.kernels import tensors as kernels

NOISE = 2
WINDOWS = (11, 15, 21, 25, 31)
SHIFTS = (0.1, 0.35, 0.6, 0.85)
TRACKERS: dict[str, Tracker] = {
    "fingerflow, a pair": track_fingerflow,
    "fingerflow, two passes": partial(track_fingerflow, passes=2),
    "OpenCV, 1 level": partial(track_opencv, levels=0),
    "OpenCV, 4 levels": partial(track_opencv, levels=3),
}
PEER = "OpenCV, 1 level", 21
FRAMES = 8
#: Frames a call.
FOLLOWERS = {"fingerflow, recorded": FRAMES, "fingerflow, live": 1}
RECIPES = ("exact", "fast")
SPEED, ACCELERATION = torch.tensor([0.2, 0.14]), torch.tensor([0.02, 0.014])  # px a frame and its change a frame
KORNIA_POINTS = 100
WRONG = 0.5  # px
_EXPORT = Path(__file__).resolve().parents[2] / "export"


class Way(NamedTuple):
    """Work of a tracker: the timed call and its number of frames, points found in K frames, the motion (K, 1, 2) px of
    the picture in them, and the points (1, N, 2) px.
    """

    call: Callable[[], object]
    frames: int
    found: Sequence[Found]
    moved: Tensor
    points: Tensor


def run(quick: bool) -> list[Row]:
    """Return a row per window and tracker."""
    shape = QUICK_SHAPE if quick else SHAPE
    corners = choose_points(shape, 150 if quick else 700, border=18)
    points = corners + torch.rand(corners.shape, generator=torch.Generator().manual_seed(0))
    pairs = _pairs(shape)
    ways = {
        (name, window): _of_pairs(track, pairs, points, window)
        for window in ((15, 21) if quick else WINDOWS)
        for name, track in TRACKERS.items()
    }
    ways["kornia", 21] = _of_pairs(track_kornia, pairs, points[:, :KORNIA_POINTS], 21)
    absent: list[Row] = []
    for recipe in RECIPES:
        window = tomllib.loads((_EXPORT / f"{recipe}.toml").read_text(encoding="utf-8"))["tracking"]["window_px"]
        for name, together in FOLLOWERS.items():
            if kernels.serve():
                ways[name, window] = _of_stream(shape, points, window, together)
            else:
                reason = "the compiled library does not serve here"
                absent.append({"window_px": window, "tracker": name, "left_out": reason})
    # All in one round, so that the windows can be compared with each other.
    calls = {_label(*name): way.call for name, way in ways.items()}
    times = time_in_turns(calls, _label(*PEER), rounds=2 if quick else 31)
    rows = [_row(*name, way, times[_label(*name)], points.shape[1]) for name, way in ways.items()]
    return [*rows, *absent, *_measured_apart()]


def write_pairs(path: str) -> None:
    """Write the pairs of frames for `bench.dic_codes`, with a grid of points (N, 2) and the bound (N,) px^2 of each."""
    pairs, (height, width) = _pairs(SHAPE), SHAPE
    grid = torch.cartesian_prod(*(torch.arange(30, size - 20, dic_codes.STEP) for size in (width, height)))[None]
    previous, current = (torch.cat(frames)[:, 0].numpy() for frames in zip(*pairs.frames, strict=True))
    np.savez(
        path,
        previous=previous,
        current=current,
        moved=pairs.moved.numpy(),
        points=grid[0].numpy(),
        variance=error_bound(grid, NOISE, dic_codes.WINDOW).diagonal(dim1=1, dim2=2).mean(1).numpy(),
        cpu=str(describe()["machine"]["cpu"]),
    )


class _Pairs(NamedTuple):
    """K pairs of frames, and the motion (K, 1, 2) px of the picture in each."""

    frames: list[tuple[Tensor, Tensor]]
    moved: Tensor


def _pairs(shape: tuple[int, int]) -> _Pairs:
    motions = [(shift, 0.7 * shift) for shift in SHIFTS]
    pairs = [photograph_pair(shape, motion, NOISE, number) for number, motion in enumerate(motions)]
    return _Pairs(pairs, torch.tensor(motions)[:, None])


def _of_pairs(track: Tracker, pairs: _Pairs, points: Tensor, window: int) -> Way:
    found = [track(*pair, points, window) for pair in pairs.frames]
    call = partial(track, *pairs.frames[1], points, window)
    return Way(call, 1, found, pairs.moved, points)


def _of_stream(shape: tuple[int, int], points: Tensor, window: int, together: int) -> Way:
    after = torch.arange(1, FRAMES + 1)[:, None, None]
    moved = after * SPEED + after**2 / 2 * ACCELERATION
    places = [(0.0, 0.0), *((x, y) for x, y in moved[:, 0].tolist())]
    key, *frames = (photograph(clean_picture(shape, place), NOISE, seed=n) for n, place in enumerate(places))
    call = partial(follow_fingerflow(key, points, window), torch.cat(frames), SPEED, together)
    return Way(call, FRAMES, call(), moved, points)


def _row(tracker: str, window: int, way: Way, timing: Timing, peer_points: int) -> Row:
    errors = torch.cat([found.points for found in way.found]) - way.points - way.moved
    accepted = torch.stack([found.accepted for found in way.found])
    wrong = accepted & (errors.norm(dim=-1) > WRONG)
    bound = error_bound(way.points, NOISE, window).repeat(len(errors), 1, 1)
    cells = error_cells(errors.flatten(0, 1), (accepted & ~wrong).flatten(), bound)
    count = way.frames * way.points.shape[1]
    return {
        "window_px": window,
        "tracker": tracker,
        "rms_px": cells["rms_px"],
        "over_bound": cells["over_bound"],
        "accepted": accepted.double().mean().item(),
        "wrong": wrong.double().mean().item(),
        "us_per_point": 1e3 * timing.median_ms / count,
        "us_p10": 1e3 * timing.low_ms / count,
        "us_p90": 1e3 * timing.high_ms / count,
        "time_to_peer": timing.to_peer * peer_points / count,
        "threads": torch.get_num_threads(),
    }


def _measured_apart() -> list[Row]:
    record = json.loads(dic_codes.RESULTS.read_text(encoding="utf-8"))
    remark = f"measured apart on {record['date']}, threads: {record['threads']}, {record['cpu']}"
    return [{**row, "remark": remark} for row in record["rows"]]


def _label(tracker: str, window: int) -> str:
    return f"{tracker}, {window} px"


class _Style(NamedTuple):
    """Style of a line: colour of the project, fill of the variant, offsets (points) of window labels and the name."""

    colour: str
    filling: str
    marker: str
    window: tuple[float, float]
    name: tuple[float, float]


_STYLES = {
    "fingerflow, recorded": _Style(RED, RED, "D", (-10, 0), (-48, 12)),
    "fingerflow, live": _Style(RED, "white", "D", (10, 0), (-40, -80)),
    "fingerflow, a pair": _Style(RED, RED, "o", (11, -2), (8, -12)),
    "OpenCV, 1 level": _Style(BLUE, BLUE, "s", (0, 10), (-42, 17)),
    "OpenCV, 4 levels": _Style(BLUE, "white", "s", (0, 10), (-46, 17)),
    "al-dic": _Style(GREEN, GREEN, "^", (0, 10), (8, 2)),
    "pyvale": _Style(GREEN, "white", "^", (0, -11), (8, -7)),
    "kornia": _Style(VIOLET, VIOLET, "^", (0, -11), (-68, -4)),
}
_TOP = 1.08  # what lies above is drawn here, with its number
_HALO = [patheffects.withStroke(linewidth=2.5, foreground="white")]


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw the time of a point against its error over the bound: a line per tracker, a marker per window."""
    figure, axes = plt.subplots(figsize=(8.4, 5), dpi=200, layout="constrained")
    axes.axhline(1, color="0.65", linewidth=0.8, zorder=0)
    for name, style in _STYLES.items():
        mine = [row for row in rows if str(row["tracker"]).startswith(name) and "us_per_point" in row]
        if not mine:
            continue
        mine.sort(key=lambda row: number(row, "window_px"))
        times, errors = ([number(row, column) for row in mine] for column in ("us_per_point", "over_bound"))
        label = name
        if errors[-1] > _TOP:
            label, errors = f"{name}, {errors[-1]:.2f}", [_TOP]
        if (lost := 1 - sum(number(row, "accepted") for row in mine) / len(mine)) > 0.005:
            label += f" ({lost:.0%} lost)"
        axes.plot(times, errors, style.marker, ls="-", c=style.colour, mfc=style.filling, ms=6, lw=1.2, clip_on=False)
        write = partial(axes.annotate, textcoords="offset points", color=style.colour, path_effects=_HALO)
        for where, error, row in zip(times, errors, mine, strict=True):
            right, up = style.window
            # OpenCV's times at 21 and 25 px are nearly the same: the larger windows above, the others below.
            below = number(row, "window_px") <= 21 and len(mine) > 2 and up > 0
            place = right, -up if below else up
            write(str(row["window_px"]), (where, error), place, ha="center", va="center", fontsize=8)
        write(label, (times[-1], errors[-1]), style.name, fontsize=9)
    axes.set_xscale("log")
    ticks = [0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.set_xlim(0.2, 6000)
    axes.set_ylim(0.91, _TOP)
    threads = next(row["threads"] for row in rows if row.get("threads"))
    clock = "processor time" if threads == 1 else f"{threads} threads"
    apart = "; ".join(sorted({f"DIC codes {row['remark']}" for row in rows if "remark" in row}))
    axes.set_xlabel(f"time per point and frame, {clock} (µs)\n{apart}")
    axes.set_ylabel("RMS error / Cramér–Rao bound")
    axes.set_title(
        f"Points of skin at a noise of {NOISE} grey levels; numbers are windows in px", loc="left", fontsize=10
    )
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path)
    plt.close(figure)
