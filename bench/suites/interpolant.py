"""Tracking errors with different image interpolants: smoothed or exact cubic spline, and bilinear.

The same Lucas-Kanade, forward only, by Newton's steps, on four interpolants: bilinear on the pixels as they are;
bilinear on pixels smoothed once by [1 2 1]/4 each way; the cubic spline that passes through the pixels, which takes an
inverse filter (SciPy's); and the cubic spline on smoothed pixels without one (what `track_points` has). The points
start at a fraction of a pixel in x and y; rows pool motions of 0, 0.25, 0.5 and 0.75 px (x, and 0.7 of it in y). rms_px
and bias_px (of the motion and coordinate where it is largest) are over all points; over_bound is the ratio to the
Cramer-Rao bound. slope_noise is the standard deviation of a component of the template's gradient that white noise of 1
grey level gives, in grey levels per px, at that fraction. ms is one call, the coefficients of both frames included.

On whole pixels the slope of a bilinear spline is a one-sided difference, half a pixel off: that is most of its error
there, and no property of bilinear trackers that take their slope elsewhere, as OpenCV's does.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import torch
from scipy.ndimage import spline_filter
from torch import Tensor

from bench.errors_of_tracks import error_cells, root_mean_square
from bench.rows import Cell, Row, number
from bench.skin import QUICK_SHAPE, SHAPE, choose_points, error_bound, photograph_pair
from bench.timing import time_in_turns
from fingerflow.ops.filters.spline import spline_coefficients
from fingerflow.ops.filters.windows import sample_windows

WINDOW = 21
SHIFTS = (0.0, 0.25, 0.5, 0.75)
_STEPS = 8  # of Newton's from the start; more change no digit


class Interpolant(NamedTuple):
    """Spline of an image: its coefficients and its order."""

    coefficients: Callable[[Tensor], Tensor]
    order: int


def _as_they_are(image: Tensor) -> Tensor:
    return image.float()


def _inverse_filtered(image: Tensor) -> Tensor:
    return torch.from_numpy(spline_filter(image[0, 0].double().numpy(), order=3, mode="mirror")).float()[None, None]


INTERPOLANTS = {
    "bilinear": Interpolant(_as_they_are, 1),
    "bilinear, smoothed": Interpolant(spline_coefficients, 1),
    "cubic, exact": Interpolant(_inverse_filtered, 3),
    "cubic, smoothed": Interpolant(spline_coefficients, 3),
}


def run(quick: bool) -> list[Row]:
    """Return a row per noise, fraction and interpolant."""
    shape = QUICK_SHAPE if quick else SHAPE
    corners = choose_points(shape, 150 if quick else 700, WINDOW)
    rows: list[Row] = []
    for noise in (0, 5) if quick else (0, 1, 2, 5):
        for fraction in (0.0, 0.3) if quick else (0.0, 0.15, 0.3, 0.5):
            rows += _rows(shape, noise, fraction, corners + fraction, quick)
    return rows


def _rows(shape: tuple[int, int], noise: int, fraction: float, points: Tensor, quick: bool) -> list[Row]:
    bound = error_bound(points, noise, WINDOW)
    cells: dict[str, list[dict[str, Cell]]] = {name: [] for name in INTERPOLANTS}
    for case, shift in enumerate(SHIFTS):
        if noise == 0 and shift == 0:
            continue  # identical images: no error and no bound
        motion = (shift, 0.7 * shift)
        previous, current = photograph_pair(shape, motion, noise, case)
        for name, interpolant in INTERPOLANTS.items():
            errors = (_track(interpolant, previous, current, points) - points[0] - torch.tensor(motion)).double()
            cells[name].append(error_cells(errors, torch.ones(len(errors), dtype=torch.bool), bound))
    times = time_in_turns(
        {name: partial(_track, interpolant, previous, current, points) for name, interpolant in INTERPOLANTS.items()},
        "cubic, smoothed",
        rounds=2 if quick else 5,
    )
    return [
        {
            "noise": noise,
            "fraction": fraction,
            "interpolant": name,
            "rms_px": root_mean_square([number(cell, "rms_px") for cell in cells[name]]),
            "over_bound": root_mean_square([number(cell, "over_bound") for cell in cells[name]]),
            "bias_px": max((number(cell, "bias_px") for cell in cells[name]), key=abs),
            "slope_noise": _slope_noise(interpolant, fraction),
            **times[name].cells(),
        }
        for name, interpolant in INTERPOLANTS.items()
    ]


def _track(interpolant: Interpolant, previous: Tensor, current: Tensor, points: Tensor) -> Tensor:
    """Return positions (N, 2) in ``current``."""
    first, second = interpolant.coefficients(previous), interpolant.coefficients(current)
    start = points[0]
    image_index = torch.zeros(len(start), dtype=torch.int64)
    template, gradient = sample_windows(first, image_index, start, WINDOW, interpolant.order)
    place = start
    for _ in range(_STEPS):
        value, slope = sample_windows(second, image_index, place, WINDOW, interpolant.order)
        residual = (gradient * (value - template)[:, None]).sum((-1, -2))
        jacobian = gradient.flatten(2) @ slope.flatten(2).mT
        place = place - torch.linalg.solve(jacobian, residual[..., None]).squeeze(-1).clamp(-1, 1)
    return place


def _slope_noise(interpolant: Interpolant, fraction: float) -> float:
    """Compute the standard deviation of the gradient of unit white noise, over a million samples."""
    noise = torch.randn((1, 1, 1031, 1031), generator=torch.Generator().manual_seed(0))
    size = 1001
    centre = torch.full((1, 2), 515.0 + fraction)
    index = torch.zeros(1, dtype=torch.int64)
    _, gradient = sample_windows(interpolant.coefficients(noise), index, centre, size, interpolant.order)
    return gradient.std().item()
