"""Errors of tracked positions where the displacement is curved: waves of 50, 100 and 300 px, and a star.

Texture of periods from 5 to 16 px in all directions, 320 x 320 px, 8 bit, noise of 2 grey levels. A wave is
u = (A sin 2 pi x / K, A cos 2 pi y / K) px; the star is v = 0.5 cos 2 pi y / K, with K rising from 40 to 300 px over x.
Points lie on a grid of 10 px, window 21 px, starting from zero displacement. `rms_px` is over both coordinates of the
accepted points, `z` the RMS of the error over the stated deviation.

Two DIC codes were measured on the same pairs in an environment of their own, as `bench.dic_codes` says: al-dic, and
pyvale with its three shape functions.
"""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import torch
from torch import Tensor

from bench.drawing import BLUE, GREEN, RED, Mark, cells, draw_dots, saved_axes, scale_by_powers
from bench.rows import Row, number
from bench.skin import Motion, photograph_motion
from bench.suites.flow import NOISE, ridges
from bench.trackers import track_opencv
from fingerflow.ops.tracking.track_points import TrackStatus, track_points

_SHAPE, _BORDER, _STEP = (320, 320), 30, 10
#: rms_px of DIC codes, measured apart.
_APART = {
    "al-dic 1.0.3": (0.0167, 0.0895, 0.0080, 0.0232, None, 0.0088, 0.0243, 0.0094),
    "pyvale 2026.10.2, rigid": (0.0232, 0.1124, 0.0110, 0.0434, None, 0.0137, 0.0333, 0.0068),
    "pyvale 2026.10.2, affine": (0.0199, 0.0937, 0.0090, 0.0266, None, 0.0078, 0.0258, 0.0072),
    "pyvale 2026.10.2, quadratic": (0.0141, 0.0185, 0.0140, 0.0143, None, 0.0142, 0.0152, 0.0138),
}
_MARKS = {
    "fingerflow": Mark(RED),
    "opencv": Mark(BLUE, "s"),
    "al-dic 1.0.3": Mark(GREEN, "^"),
    "pyvale 2026.10.2, affine": Mark(GREEN, "v", filled=False),
    "pyvale 2026.10.2, quadratic": Mark(GREEN, "v"),
}


def run(quick: bool) -> list[Row]:
    """Return a row per field and tracker."""
    fields: dict[str, Motion] = {
        f"K {period}, A {height}": _wave(period, height) for period in (50, 100, 300) for height in (0.1, 0.5)
    }
    fields |= {"star": _star, "uniform": lambda x, y: (torch.full_like(x, 0.3), torch.full_like(x, -0.4))}
    if quick:
        fields = {name: fields[name] for name in ("K 50, A 0.1", "K 100, A 0.5", "star", "uniform")}
    side = torch.arange(_BORDER, _SHAPE[0] - _BORDER + 1, _STEP)
    points = torch.cartesian_prod(side, side).float()[None]
    texture = ridges(400, 5.0, 16.0)
    rows: list[Row] = []
    for name, field in fields.items():
        first, current = photograph_motion(texture, field, _SHAPE, NOISE)
        truth = torch.stack(field(*points[0].double().unbind(-1)), dim=-1)
        ours, peer = track_points(first, current, points), track_opencv(first, current, points)
        found = {
            "fingerflow": (ours.points[0], ours.status[0] == TrackStatus.TRACKED),
            "opencv": (peer.points[0], peer.accepted),
        }
        for tracker, (places, accepted) in found.items():
            error = (places.double() - points[0] - truth)[accepted]
            deviation = ours.covariance[0, accepted].diagonal(dim1=1, dim2=2).sqrt()
            rows.append(
                {
                    "field": name,
                    "tracker": tracker,
                    "accepted": accepted.double().mean().item(),
                    "rms_px": error.square().mean().sqrt().item(),
                    "z": (error / deviation).square().mean().sqrt().item() if tracker == "fingerflow" else None,
                }
            )
    return rows if quick else rows + measured_apart(fields)


def measured_apart(fields: Iterable[str]) -> list[Row]:
    """Return the rows of the DIC codes."""
    apart = [(code, *one) for code, errors in _APART.items() for one in zip(fields, errors, strict=True)]
    return [{"field": name, "tracker": code, "rms_px": error} for code, name, error in apart if error is not None]


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw the error of each tracker, a row per field from the least to the most curved."""
    ours = {str(row["field"]): number(row, "rms_px") for row in rows if row["tracker"] == "fingerflow"}
    fields = sorted(ours, key=ours.__getitem__)
    values = {tracker: cells(rows, "rms_px", "field", fields, tracker=tracker) for tracker in _MARKS}
    with saved_axes(path, 3.4) as (axes,):
        draw_dots(axes, [one.replace("K", "period").replace("A", "height") for one in fields], values, _MARKS)
        scale_by_powers(axes.xaxis)
        axes.set_xlabel("RMS error of a coordinate (px)")
        axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))


def _wave(period: float, height: float) -> Motion:
    turn = 2 * math.pi / period
    return lambda x, y: (height * torch.sin(turn * x), height * torch.cos(turn * y))


def _star(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    period = 40 + 260 * x / _SHAPE[1]
    return torch.zeros_like(x), 0.5 * torch.cos(2 * math.pi * (y - _SHAPE[0] / 2) / period)
