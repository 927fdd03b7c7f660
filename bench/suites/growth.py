"""How time grows with points, window, image, frames and threads, this project beside OpenCV.

`tracking` is one call of the trackers, forward and backward, 1 level, points anywhere in the skin moved by 0.3 px;
`contact` is one frame of a press in full contact: `ContactGraph` and what the suite `pipeline` has of OpenCV, from the
frame to areas and ellipse; `pipeline` are the whole pipelines of that suite on small views, ms a frame. Where nothing
else is said: 700 points, window 21 px, 512 x 640 px (a quarter of the side and fewer points with --quick), the threads
that the command was given. The finger grows with the image, its ridges do not.

`exponent` is how time grows from the row before to this one, ms ~ value^exponent: 0 is free, 1 is in proportion; by
`image` it is counted in pixels, and with `threads` -1 would be all that can be had.

- Both trackers have a share that only the image asks for (spline coefficients, pyramids): few points cost more each.
- More threads than free cores say nothing.
"""

import math
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

from bench.opencv_pipeline import ContactFinder, Rig
from bench.rows import Row
from bench.skin import MM_PER_PX, clean_picture, photograph
from bench.suites.pipeline import PIPELINES, QUICK_PRESS, write_quietly
from bench.timing import time_in_turns
from bench.trackers import TRACKERS
from fingerflow.graphs import ContactGraph, LightGraph
from fingerflow.synthetic import Press

PEER = "opencv"
SHAPE, QUICK_SHAPE = (512, 640), (128, 160)
POINTS, QUICK_POINTS = 700, 100
WINDOW = 21

Ways = Mapping[str, Callable[[], object]]


class Case(NamedTuple):
    """One thing done in two ways, at one value of what grows; ``size`` is the value as a number."""

    grows: str
    value: str
    size: float
    work: str
    ways: Ways
    each: int = 1  # ms is a run's over this


def run(quick: bool) -> list[Row]:
    """One row a value and way."""
    shape, points = (QUICK_SHAPE, QUICK_POINTS) if quick else (SHAPE, POINTS)
    cases = [*_points(shape, quick), *_windows(shape, points, quick), *_images(points, quick)]
    rows = [row for case in cases for row in _rows(case, rounds=2 if quick else 5)]
    for count in (1, 2):
        with _threads(count):
            for case in _with_threads(count, shape, points):
                rows += _rows(case, rounds=2 if quick else 5)
    with tempfile.TemporaryDirectory() as folder:
        for case in _frames(Path(folder), quick):
            rows += _rows(case, rounds=2)
    return _with_exponents(rows)


def _points(shape: tuple[int, int], quick: bool) -> Iterator[Case]:
    for count in (100, 400) if quick else (100, 300, 700, 2000, 5000):
        yield Case("points", str(count), count, "tracking", _tracking(shape, count))


def _windows(shape: tuple[int, int], points: int, quick: bool) -> Iterator[Case]:
    for window in (11, 21) if quick else (11, 15, 21, 25, 31):
        yield Case("window", f"{window} px", window, "tracking", _tracking(shape, points, window))


def _images(points: int, quick: bool) -> Iterator[Case]:
    shapes = ((96, 120), (128, 160)) if quick else ((240, 320), (512, 640), (1024, 1280), (2048, 2048))
    for work in ("tracking", "contact"):
        for shape in shapes:
            ways = _tracking(shape, points) if work == "tracking" else _contact(shape)
            yield Case("image", f"{shape[0]} x {shape[1]} px", math.prod(shape), work, ways)


def _with_threads(count: int, shape: tuple[int, int], points: int) -> Iterator[Case]:
    for work, ways in (("tracking", _tracking(shape, points)), ("contact", _contact(shape))):
        yield Case("threads", str(count), count, work, ways)


def _frames(folder: Path, quick: bool) -> Iterator[Case]:
    for count in (4, 8) if quick else (30, 60, 120):
        press = replace(QUICK_PRESS, n_frames=count, frame_rate=float(count))
        write_quietly(folder / str(count), press)
        ways = {name: partial(pipeline, folder / str(count), press) for name, pipeline in PIPELINES.items()}
        yield Case("frames", str(count), count, "pipeline", ways, each=count)


def _rows(case: Case, rounds: int) -> list[dict[str, str | float]]:
    times = time_in_turns(case.ways, PEER, rounds)
    return [
        {
            "grows": case.grows,
            "value": case.value,
            "size": case.size,
            "work": case.work,
            "way": name,
            **times[name].of_each(case.each).cells(),
        }
        for name in case.ways
    ]


def _with_exponents(rows: list[dict[str, str | float]]) -> list[Row]:
    """The rows with the growth from the one before it of the same kind, and without the size that it is taken by."""
    before: dict[tuple[object, ...], tuple[float, float]] = {}
    result: list[Row] = []
    for row in rows:
        kind = row["grows"], row["work"], row["way"]
        size, ms = float(row["size"]), float(row["ms"])
        smaller = before.get(kind)
        exponent = None if smaller is None else math.log(ms / smaller[1]) / math.log(size / smaller[0])
        before[kind] = size, ms
        result.append({**{name: cell for name, cell in row.items() if name != "size"}, "exponent": exponent})
    return result


@contextmanager
def _threads(count: int) -> Iterator[None]:
    before = torch.get_num_threads(), cv2.getNumThreads()
    torch.set_num_threads(count)
    cv2.setNumThreads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before[0])
        cv2.setNumThreads(before[1])


def _tracking(shape: tuple[int, int], count: int, window: int = WINDOW) -> Ways:
    pair = [photograph(clean_picture(shape, shift), 2, seed) for seed, shift in enumerate(((0.0, 0.0), (0.3, 0.2)))]
    margin = 18  # px, half of the largest window and the motion
    room = torch.tensor([shape[1] - 1 - 2 * margin, shape[0] - 1 - 2 * margin], dtype=torch.float32)
    points = margin + room * torch.rand(1, count, 2, generator=torch.Generator().manual_seed(0))
    return {name: partial(track, *pair, points, window) for name, track in TRACKERS.items()}


def _contact(shape: tuple[int, int]) -> Ways:
    rows, columns = shape
    large = min(rows / 512, columns / 640)
    press = Press(
        n_frames=2,
        frame_rate=1.0,
        frames_before_trigger=0,
        frame_shape=(rows, 2 * columns),
        finger=(7.6 * large, 6.4 * large),
        semi_axes=(5.5 * large, 4.5 * large),
    )
    view = press.views["contact"]
    frame, empty, dark = (
        np.ascontiguousarray(view.crop(picture)) for picture in (press.render(1), press.empty(), press.dark())
    )
    reference, black = empty.astype(np.float32), dark.astype(np.float32)
    finder = ContactFinder(frame, Rig(reference, black, MM_PER_PX, np.array(press.topography_to_contact)))
    images = [torch.from_numpy(image)[None, None] for image in (frame, reference, black)]
    graph = ContactGraph()
    light, empty_black, _ = LightGraph()(images[1], images[2], torch.zeros(1))
    limit = 1 - graph.threshold(images[0], light, empty_black)

    def with_fingerflow() -> Tensor:
        with torch.inference_mode():
            result: Tensor = graph(images[0], light, empty_black, limit).gross_area_px
            return result

    return {PEER: lambda: finder.find(frame), "fingerflow": with_fingerflow}
