"""Tracking over displacements of several pixels: share of points found, and share of wrong points accepted.

Window 21 px, noise of 2 grey levels, up to 700 corners, four directions of each distance; a point is accepted if it
returns within 0.5 px when it is tracked back. `wrong` is the share of all points that are accepted and lie more than
0.5 px from the truth; rms_px is over the accepted ones, wrong or not. Ridges repeat every 15 px: the neighbouring ridge
is a good match in the wrong place.
"""

import math
from functools import partial

import torch

from bench.errors_of_tracks import error_cells
from bench.rows import Row
from bench.skin import QUICK_SHAPE, SHAPE, choose_points, photograph_pair
from bench.timing import time_in_turns
from bench.trackers import track_fingerflow, track_opencv

TRACKERS = {
    "opencv, 1 level": partial(track_opencv, levels=0, limit=0.5),
    "opencv, 4 levels": partial(track_opencv, levels=3, limit=0.5),
    "fingerflow": partial(track_fingerflow, limit=0.5),
}
SEARCH = {3: 8, 5: 8, 50: 64}  # px in which points are searched for, by how far they moved
WRONG = 0.5  # px


def run(quick: bool) -> list[Row]:
    """Return a row per distance and tracker."""
    shape = QUICK_SHAPE if quick else SHAPE
    # Far enough inside for the window and its motion to stay in the frame.
    points = choose_points(shape, 100 if quick else 700, border=64)
    rows: list[Row] = []
    for distance, search in SEARCH.items():
        trackers = {**TRACKERS, f"fingerflow, search {search} px": partial(track_fingerflow, search=search, limit=0.5)}
        angles = (0.3,) if quick else (0.3, 1.9, 3.4, 5.0)
        motions = [(distance * math.cos(angle), distance * math.sin(angle)) for angle in angles]
        pairs = [photograph_pair(shape, motion, 2, number) for number, motion in enumerate(motions)]
        times = time_in_turns(
            {name: partial(track, *pairs[0], points) for name, track in trackers.items()},
            "opencv, 4 levels",
            rounds=2 if quick else 5,
        )
        for name, track in trackers.items():
            found = [track(*pair, points) for pair in pairs]
            errors = torch.cat([(f.points - points - torch.tensor(m))[0] for f, m in zip(found, motions, strict=True)])
            accepted = torch.cat([f.accepted for f in found])
            wrong = accepted & (errors.norm(dim=-1) > WRONG)
            cells = error_cells(errors, accepted)
            rows.append(
                {
                    "motion_px": distance,
                    "tracker": name,
                    "accepted": cells["accepted"],
                    "wrong": wrong.double().mean().item(),
                    "rms_px": cells["rms_px"],
                    **times[name].cells(),
                }
            )
    return rows
