"""Peak memory of `fingerflow.process` with all outputs, on longer and longer recordings: does it hold the frames, and,
where results go to a file (`to`), does it hold these?

A press at 1,000 fps in two views of 160 x 200 px that comes to rest after 22 frames; eight pictures of it at rest, each
with its own noise, follow over and over. One fresh process takes all recordings, the shortest first and once more
before that, so that what is loaded and cached once is not counted as growth. peak_mb is the most memory of the
process's own (anonymous pages, looked at every 5 ms), torch and the other libraries included; resident_mb counts pages
of the mapped recording too, which the system takes back when it needs them. A recording held in memory would grow by
frame_bytes a frame. What remains grows by growth_bytes, counted from the row before: numbers of points and triangles,
of which the result keeps result_bytes a frame. With results in a file views are 800 x 1000 px with 5,000 points, and
`of_first` is the peak over that of the first of these rows.
"""

import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.peak_memory import STATUS
from bench.rows import Cell, Row, Skipped
from bench.suites.pipeline import write_quietly
from fingerflow.synthetic import Press

_RISE, _STILL = 24, 8  # frames


class LongPress(Press):
    """A press that is not rendered anew for every frame at rest."""

    def render(self, frame: int) -> NDArray[np.integer]:
        return _picture(frame if frame < _RISE else _RISE + frame % _STILL, self.frame_shape)


_SMALL, _LARGE = (160, 400), (800, 2000)  # rows and columns of both views


def run(quick: bool) -> list[Row]:
    """One row a number of frames, with results in memory, and with results in a file."""
    if not STATUS.exists():
        raise Skipped(f"memory is read from {STATUS}, which only Linux has")
    in_memory, in_file = ((10, 40), (10, 40)) if quick else ((200, 800, 3200), (300, 3000))
    many = {"points": 5000, "min_distance_px": 3.0}
    return [*_rows(in_memory, _SMALL, {}), *_rows(in_file, _SMALL if quick else _LARGE, many, "file")]


def _rows(counts: Sequence[int], shape: tuple[int, int], tracking: dict[str, float], to: str = "memory") -> list[Row]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for count in counts:
            write_quietly(folder / str(count), _press(count, shape))
            scene = folder / str(count) / "scene.toml"
            text = scene.read_text(encoding="utf-8")
            for key, value in tracking.items():
                text = re.sub(rf"^{key} = .*$", f"{key} = {value}", text, flags=re.MULTILINE)
            scene.write_text(text, encoding="utf-8")
        scenes = [str(folder / str(count) / "scene.toml") for count in counts]
        child = subprocess.run(
            [sys.executable, "-m", "bench.peak_memory", to, *scenes], check=True, stdout=subprocess.PIPE, text=True
        )
        frame_bytes = _picture(0, shape).nbytes
    rows: list[Row] = []
    before: tuple[int, int] | None = None
    for count, found in zip(counts, json.loads(child.stdout), strict=True):
        row: dict[str, Cell] = {
            "to": to,
            "frames": count,
            "points": found["points"],
            "recording_mb": count * frame_bytes / 1e6,
            "peak_mb": found["own_bytes"] / 1e6,
            "of_first": found["own_bytes"] / (rows[0]["peak_mb"] * 1e6) if rows else 1.0,  # type: ignore[operator]
            "resident_mb": found["resident_bytes"] / 1e6,
            "frame_bytes": frame_bytes,
            "growth_bytes": None if before is None else (found["own_bytes"] - before[1]) // (count - before[0]),
            "result_bytes": found["result_bytes"] // count,
            "ms": 1e3 * found["seconds"] / count,
        }
        rows.append(row)
        before = count, found["own_bytes"]
    return rows


def _press(count: int, shape: tuple[int, int]) -> LongPress:
    finger, axes = ((2.6, 2.2), (1.9, 1.6)) if shape == _SMALL else ((14.0, 12.5), (12.4, 11.0))
    return LongPress(
        n_frames=count,
        frame_rate=1000.0,
        frames_before_trigger=1,
        contact_time=0.001,
        rise_time=0.02,
        frame_shape=shape,
        finger=finger,
        semi_axes=axes,
    )


@lru_cache
def _picture(frame: int, shape: tuple[int, int]) -> NDArray[np.integer]:
    return Press.render(_press(_RISE + _STILL, shape), frame)
