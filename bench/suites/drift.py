"""A hundred frames of skin that spreads and moves slowly: errors that add up, and errors that do not.

Noise of 2 grey levels, window 21 px. The skin moves by up to 14 px, spreads by up to 4 % and turns by 0.02 rad. From
frame to frame every position is the start of the next step: its error is a random walk. With a keyframe every frame is
compared with the first one, starting where the point was last. `fingerflow, keyframe` deforms the template by the
gradient of the motion found so far (`local_gradients` over 120 px), as the pipeline does; OpenCV has no such setting.
rms_px is over both coordinates of the points that were accepted in every frame so far; over_bound its ratio to the
Cramer-Rao bound of two frames.
"""

from functools import partial

import torch
from torch import Tensor

from bench.errors_of_tracks import error_cells
from bench.rows import Row
from bench.skin import choose_points, clean_picture, deformed_picture, error_bound, photograph
from bench.trackers import Found, Tracker, track_fingerflow, track_opencv
from fingerflow.ops.fields.local_fit import local_gradients

SHAPE = (384, 448)
NOISE = 2
WINDOW = 21
WARP_GAUGE_PX = 120.0
MOTION = torch.tensor((12.0, -7.0), dtype=torch.float64)
GRADIENT = torch.tensor(((0.04, -0.02), (0.02, 0.03)), dtype=torch.float64)
CENTRE = torch.tensor((224.0, 192.0), dtype=torch.float64)


def run(quick: bool) -> list[Row]:
    """Rows for a few frames of the sequence, the last one included."""
    count = 12 if quick else 100
    points = choose_points(SHAPE, 60 if quick else 300, border=40)
    bound = error_bound(points, NOISE, WINDOW)
    first = photograph(clean_picture(SHAPE, (0.0, 0.0)), NOISE, seed=0)
    trackers: dict[str, _FromFrameToFrame | _FromKeyframe] = {
        "opencv, frame to frame": _FromFrameToFrame(partial(track_opencv, window=WINDOW), first, points),
        "opencv, keyframe": _FromKeyframe(partial(track_opencv, window=WINDOW), first, points),
        "fingerflow, frame to frame": _FromFrameToFrame(partial(track_fingerflow, window=WINDOW), first, points),
        "fingerflow, keyframe": _FromKeyframe(_with_warp, first, points),
    }
    rows: list[Row] = []
    for number in range(1, count + 1):
        progress = number / 100
        frame = photograph(_picture(progress), NOISE, seed=number)
        for name, tracker in trackers.items():
            tracker.step(frame)
            if number in (1, 3, 10, 30, count):
                errors = (tracker.points - _truth(points, progress))[0]
                rows.append({"frame": number, "tracker": name, **error_cells(errors, tracker.accepted, bound)})
    return rows


def _truth(points: Tensor, progress: float) -> Tensor:
    """Where material points (..., 2) px of the first frame are: c + F (x - c) + d."""
    deformation = torch.eye(2, dtype=torch.float64) + progress * GRADIENT
    return (points.double() - CENTRE) @ deformation.T + CENTRE + progress * MOTION


def _picture(progress: float) -> Tensor:
    (a, b), (c, d) = torch.linalg.inv(torch.eye(2, dtype=torch.float64) + progress * GRADIENT).tolist()
    (centre_x, centre_y), (shift_x, shift_y) = CENTRE.tolist(), (progress * MOTION).tolist()

    def material(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        x, y = x - (centre_x + shift_x), y - (centre_y + shift_y)
        return a * x + b * y + centre_x, c * x + d * y + centre_y

    return deformed_picture(SHAPE, material)


class _FromFrameToFrame:
    """Each frame is compared with the one before."""

    def __init__(self, track: Tracker, first: Tensor, points: Tensor) -> None:
        self._track = track
        self._previous = first
        self.points = points
        self.accepted = torch.ones(points.shape[1], dtype=torch.bool)

    def step(self, frame: Tensor) -> None:
        found = self._track(self._previous, frame, self.points)
        self._previous, self.points = frame, found.points
        self.accepted = self.accepted & found.accepted


class _FromKeyframe:
    """Each frame is compared with the first one."""

    def __init__(self, track: Tracker, first: Tensor, points: Tensor) -> None:
        self._track = track
        self._first = first
        self._start = points
        self.points = points
        self.accepted = torch.ones(points.shape[1], dtype=torch.bool)

    def step(self, frame: Tensor) -> None:
        found = self._track(self._first, frame, self._start, initial=self.points)
        self.points = torch.where(found.accepted[:, None], found.points, self.points)
        self.accepted = self.accepted & found.accepted


def _with_warp(first: Tensor, frame: Tensor, start: Tensor, *, initial: Tensor) -> Found:
    fit = local_gradients(start, initial - start, gauge_length=WARP_GAUGE_PX)
    return track_fingerflow(
        first, frame, start, WINDOW, initial=initial, warp=fit.gradient.nan_to_num(0) + torch.eye(2)
    )
