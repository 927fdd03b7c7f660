"""Accumulation of tracking errors over a hundred frames of skin that spreads and moves slowly.

Noise of 2 grey levels, window 21 px. The skin moves by up to 14 px, spreads by up to 4 % and turns by 0.02 rad. From
frame to frame every position is the start of the next step: its error is a random walk. With a keyframe every frame is
compared with the first one, starting where the point was last. `fingerflow, keyframe` deforms the template by the
gradient of the motion found so far (`local_gradients` over 120 px), as the pipeline does; OpenCV has no such setting.
rms_px is over both coordinates of the points that were accepted in every frame so far; over_bound its ratio to the
Cramer-Rao bound of two frames.
"""

from functools import partial
from itertools import pairwise

import torch
from torch import Tensor

from bench.errors_of_tracks import error_cells
from bench.rows import Row
from bench.skin import choose_points, deformed_picture, error_bound, photograph
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
    """Return rows for a few frames of the sequence, the last one included."""
    count = 12 if quick else 100
    points = choose_points(SHAPE, 60 if quick else 300, border=40)
    bound = error_bound(points, NOISE, WINDOW)
    frames = [photograph(_picture(number / 100), NOISE, seed=number) for number in range(count + 1)]
    opencv, fingerflow = (partial(track, window=WINDOW) for track in (track_opencv, track_fingerflow))
    followed = {
        "opencv, frame to frame": _from_frame_to_frame(opencv, frames, points),
        "opencv, keyframe": _from_keyframe(opencv, frames, points),
        "fingerflow, frame to frame": _from_frame_to_frame(fingerflow, frames, points),
        "fingerflow, keyframe": _from_keyframe(_with_warp, frames, points),
    }
    rows: list[Row] = []
    for number in [frame for frame in (1, 3, 10, 30, count) if frame <= count]:
        truth = _truth(points, number / 100)
        for name, found in followed.items():
            errors = (found[number].points - truth)[0]
            rows.append({"frame": number, "tracker": name, **error_cells(errors, found[number].accepted, bound)})
    return rows


def _from_frame_to_frame(track: Tracker, frames: list[Tensor], points: Tensor) -> list[Found]:
    """Track each frame from the one before; a point counts as accepted until it is not in one frame."""
    found = [Found(points, torch.ones(points.shape[1], dtype=torch.bool))]
    for previous, frame in pairwise(frames):
        last, new = found[-1], track(previous, frame, found[-1].points)
        found.append(Found(new.points, last.accepted & new.accepted))
    return found


def _from_keyframe(track: Tracker, frames: list[Tensor], points: Tensor) -> list[Found]:
    """Track each frame from the first one, starting where the point was last; accepted as above."""
    found = [Found(points, torch.ones(points.shape[1], dtype=torch.bool))]
    for frame in frames[1:]:
        last, new = found[-1], track(frames[0], frame, points, initial=found[-1].points)
        place = torch.where(new.accepted[:, None], new.points, last.points)
        found.append(Found(place, last.accepted & new.accepted))
    return found


def _truth(points: Tensor, progress: float) -> Tensor:
    """Return the positions c + F (x - c) + d of material points (..., 2) px of the first frame."""
    deformation = torch.eye(2, dtype=torch.float64) + progress * GRADIENT
    return (points.double() - CENTRE) @ deformation.T + CENTRE + progress * MOTION


def _picture(progress: float) -> Tensor:
    (a, b), (c, d) = torch.linalg.inv(torch.eye(2, dtype=torch.float64) + progress * GRADIENT).tolist()
    (centre_x, centre_y), (shift_x, shift_y) = CENTRE.tolist(), (progress * MOTION).tolist()

    def material(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        x, y = x - (centre_x + shift_x), y - (centre_y + shift_y)
        return a * x + b * y + centre_x, c * x + d * y + centre_y

    return deformed_picture(SHAPE, material)


def _with_warp(first: Tensor, frame: Tensor, start: Tensor, *, initial: Tensor) -> Found:
    fit = local_gradients(start, initial - start, gauge_length=WARP_GAUGE_PX)
    return track_fingerflow(
        first, frame, start, WINDOW, initial=initial, warp=fit.gradient.nan_to_num(0) + torch.eye(2)
    )
