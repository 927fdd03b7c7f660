"""Errors of displacement and strain on sample 14 of the DIC Challenge, whose true values are published.

A real speckle pattern (589 x 2048 px, 8 bit) displaced along x by 0.1 px sin(phase), the phase running faster and
faster with x; L1, L3 and L5 are one, three and five times as fast, the half wave falling to 310, 87 and 50 px; v = 0.
Each is tracked from the reference on a grid of 10 px (40 px from the border), window 21 px, starting from zero; strain
is du/dx of `local_gradients` over a gauge length of 61 px, on the displacements of either tracker, where the whole
gauge lies on the grid (71 px from the border). Errors are against `command.csv`, those of strain in microstrain (ue).

Truth depends on x alone, so every error splits without further assumption: `systematic` is the error of the mean of a
grid column (window and gauge flatten short waves; a seventh of the random part stays in it), `random` the scatter
around it. u_gain is the slope of the measured u over the truth's mean across the window, the most that a window can
tell: 1 without bias. A tracker that overestimates small displacements makes up for some of the flattening, and comes
out ahead where waves are short, on L5, for that reason alone. ms is the tracking, forward and backward. --quick tracks
the last 500 columns of L5 only.

Checked before use: the displaced frames show the reference at x - u(x) (the opposite sign, or the truth moved by half a
pixel, leaves a larger difference), du/dx in the file is the derivative of u, and the frames carry a noise of 5 grey
levels that the reference has no part in. Two of the 2048 values of L3 (x = 716 and 1332) are off by 0.00003 px, which
is nothing here.

Packages for DIC cannot be installed beside this project; `bench.dic_codes` measures two of them on synthetic skin.
"""

from functools import partial
from pathlib import Path

import numpy as np
import tifffile
import torch
from numpy.typing import NDArray
from torch import Tensor

from bench.rows import Row, Skipped
from bench.timing import time_in_turns
from bench.trackers import TRACKERS
from fingerflow.ops.fields.local_fit import local_gradients

FOLDER = Path(__file__).resolve().parents[3] / "shared" / "data" / "dic" / "sample14"
FIRST_COLUMN = {"L1": 1, "L3": 3, "L5": 5}  # of command.csv: u, and after it du/dx
WINDOW = 21
STEP = 10
BORDER = 40
GAUGE_PX = 61.0


def run(quick: bool) -> list[Row]:
    """Return a row per image and tracker."""
    if not FOLDER.is_dir():
        raise Skipped(
            f"the DIC Challenge's sample 14 is not here: there is no {'/'.join(FOLDER.parts[-4:])} beside the project"
        )
    command = np.loadtxt(FOLDER / "command.csv", delimiter=",")
    columns = slice(len(command) - 500 if quick else 0, len(command))
    reference = _read("reference", columns)
    points = _grid(reference.shape)
    rows: list[Row] = []
    for name in ("L5",) if quick else FIRST_COLUMN:
        current = _read(name, columns)
        truth, strain = command[columns, FIRST_COLUMN[name]], command[columns, FIRST_COLUMN[name] + 1]
        times = time_in_turns(
            {tracker: partial(track, reference, current, points, WINDOW) for tracker, track in TRACKERS.items()},
            "opencv",
            rounds=2 if quick else 3,
        )
        for tracker, track in TRACKERS.items():
            found = track(reference, current, points, WINDOW)
            displacement = torch.where(found.accepted[:, None], found.points - points, torch.nan)
            gradient = local_gradients(points, displacement, gauge_length=GAUGE_PX).gradient
            inner = _well_inside(points, reference.shape)
            rows.append(
                {
                    "image": name,
                    "tracker": tracker,
                    "points": points.shape[1],
                    "accepted": found.accepted.double().mean().item(),
                    **_errors("u", "px", displacement[0, :, 0], points, truth),
                    "u_gain": _gain(displacement[0, :, 0], points, truth),
                    "v_rms_px": displacement[0, :, 1].double().square().nanmean().sqrt().item(),
                    **_errors("strain", "ue", 1e6 * gradient[0, inner, 0, 0], points[:, inner], strain),
                    **times[tracker].cells(),
                }
            )
    return rows


def _read(name: str, columns: slice) -> Tensor:
    return torch.from_numpy(tifffile.imread(FOLDER / f"{name}.tif")[:, columns].copy())[None, None]


def _grid(shape: torch.Size) -> Tensor:
    """Return points (1, N, 2) on whole pixels, column after column of the grid."""
    height, width = shape[-2:]
    x, y = torch.arange(BORDER, width - BORDER, STEP), torch.arange(BORDER, height - BORDER, STEP)
    return torch.cartesian_prod(x, y).float()[None]


def _well_inside(points: Tensor, shape: torch.Size) -> Tensor:
    """Return True (N,) where the whole support of the strain lies on the grid."""
    last = points[0].amax(0)
    margin = GAUGE_PX / 2
    return ((points[0] >= BORDER + margin) & (points[0] <= last - margin)).all(-1)


def _errors(name: str, unit: str, measured: Tensor, points: Tensor, truth: NDArray[np.float64]) -> dict[str, float]:
    """Compute the RMS error against the truth of each pixel column, and its two parts."""
    column = points[0, :, 0].long()
    error = measured.double() - torch.from_numpy(truth)[column]
    by_column = error.view(len(column.unique()), -1)
    systematic = by_column.nanmean(1)
    random = by_column - systematic[:, None]
    parts = {"rms": error, "systematic": systematic, "random": random}
    return {f"{name}_{part}_{unit}": values.square().nanmean().sqrt().item() for part, values in parts.items()}


def _gain(measured: Tensor, points: Tensor, truth: NDArray[np.float64]) -> float:
    """Compute the least-squares slope of the measured displacement over the truth's mean across the window."""
    half = WINDOW // 2
    mean = np.convolve(np.pad(truth, half, mode="edge"), np.full(WINDOW, 1 / WINDOW), mode="valid")
    known = measured.isfinite()
    expected = torch.from_numpy(mean)[points[0, known, 0].long()]
    return ((measured[known].double() * expected).sum() / expected.square().sum()).item()
