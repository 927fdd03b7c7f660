"""Accuracy of dense optical flow sampled at the tracked points, compared with point trackers.

Skin of 256 x 320 px (smaller with --quick) at a noise of 2 grey levels, all corners on whole pixels at least 24 px
inside, where a dense flow is read without interpolation. Motions: 0.35 px or 5 px for all pixels alike, and a wave, a
shear of 0.5 px sin(2 pi y / 120 px), strain 0.026 at most, as skin has it. rms_px is over both coordinates of the
points less than 0.5 px off; `wrong` is the share of the others; over_bound the ratio to the Cramer-Rao bound of 21 px
windows, by which the trackers are meant. ms is one call, for all pixels where the way is dense.

- Motion alike for all pixels flatters whoever smooths over more than a window: below the bound is no miracle there.
- DIS is OpenCV's preset `medium`, and the same down to whole pixels with patches of 16 px; ILK (radius 10 px, as large
  as the window) and TV-L1 (attachment 5; by default its error is twice as large) are scikit-image's.
- PyrLK has 3 levels; fingerflow searches 16 px.
"""

import math
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from skimage.registration import optical_flow_ilk, optical_flow_tvl1
from torch import Tensor

from bench.errors_of_tracks import error_cells
from bench.rows import Row
from bench.skin import choose_points, deformed_picture, error_bound, photograph
from bench.timing import time_in_turns
from bench.trackers import track_fingerflow, track_opencv

NOISE = 2
BORDER = 24
WRONG = 0.5  # px
PERIOD, AMPLITUDE = 120.0, 0.5  # px
# Shift along (0.8, 0.6) and amplitude of the wave, px.
MOTIONS = {"0.35 px": (0.35, 0.0), "5 px": (5.0, 0.0), "wave": (0.0, AMPLITUDE)}
PEER = "opencv PyrLK"

Way = Callable[[], Tensor]


def run(quick: bool) -> list[Row]:
    """One row a motion and way."""
    shape = (128, 160) if quick else (256, 320)
    points = choose_points(shape, 400, BORDER)
    bound = error_bound(points, NOISE, window=21)
    rows: list[Row] = []
    for motion, (shift, amplitude) in MOTIONS.items():
        if quick and motion == "0.35 px":
            continue
        previous, current = (
            _picture(shape, *moved, seed) for seed, moved in enumerate(((0.0, 0.0), (shift, amplitude)))
        )
        ways = _ways(previous, current, points)
        times = time_in_turns(ways, PEER, rounds=2 if quick else 3)
        truth = torch.stack(_displacement(points[0, :, 1], shift, amplitude), dim=-1)
        for name, way in ways.items():
            errors = way() - truth
            wrong = ~(errors.norm(dim=-1) <= WRONG)  # NaN is wrong too
            cells = error_cells(errors, ~wrong, bound)
            rows.append(
                {
                    "motion": motion,
                    "way": name,
                    "rms_px": cells["rms_px"],
                    "over_bound": cells["over_bound"],
                    "wrong": wrong.double().mean().item(),
                    **times[name].cells(),
                }
            )
    return rows


def _displacement(y: Tensor, shift: float, amplitude: float) -> tuple[Tensor, Tensor]:
    """Of skin in row y: along x by 0.8 of the shift and by the wave, along y by 0.6."""
    along_x = 0.8 * shift + amplitude * torch.sin(2 * math.pi / PERIOD * y)
    return along_x, torch.full_like(along_x, 0.6 * shift)


def _picture(shape: tuple[int, int], shift: float, amplitude: float, seed: int) -> Tensor:
    def material(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        row = y - 0.6 * shift
        along_x, along_y = _displacement(row, shift, amplitude)
        return x - along_x, y - along_y

    return photograph(deformed_picture(shape, material), NOISE, seed)


def _ways(previous: Tensor, current: Tensor, points: Tensor) -> dict[str, Way]:
    """Displacements (N, 2) px of the points; the peer first."""
    first, second = previous[0, 0].numpy(), current[0, 0].numpy()
    column, row = points[0].long().unbind(-1)

    def dense(flow: Callable[[], NDArray[np.float32]]) -> Way:
        """``flow`` gives (H, W, 2) as (x, y)."""
        return lambda: torch.from_numpy(flow())[row, column]

    def of_opencv(algorithm: Any) -> Way:  # its stubs do not know that there may be no initial flow
        return dense(lambda: algorithm.calc(first, second, None))

    def of_scikit_image(algorithm: Callable[..., NDArray[np.float32]], **settings: float) -> Way:
        def flow() -> NDArray[np.float32]:
            down, right = algorithm(first, second, dtype=np.float32, **settings)
            return np.stack((right, down), axis=-1)

        return dense(flow)

    whole_pixels = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    whole_pixels.setFinestScale(0)
    whole_pixels.setPatchSize(16)
    whole_pixels.setGradientDescentIterations(50)
    return {
        PEER: lambda: (track_opencv(previous, current, points, levels=2).points - points)[0],
        "fingerflow": lambda: (track_fingerflow(previous, current, points, search=16).points - points)[0],
        "opencv DIS, medium": of_opencv(cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)),
        "opencv DIS, whole pixels": of_opencv(whole_pixels),
        "scikit-image ILK": of_scikit_image(optical_flow_ilk, radius=10),
        "scikit-image TV-L1": of_scikit_image(optical_flow_tvl1, attachment=5),
    }
