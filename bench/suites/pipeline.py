"""Time and errors of a whole recording, from frames to areas, tracks and strain: `fingerflow.process` and OpenCV.

The simulated press of `make demo`, 300 frames of two 512 x 640 px views (a small one of 24 with --quick), 20 px of
motion, noise of 2 grey levels. Both pipelines read the same file and do the same work: light divided by that of the
empty glass, real and gross contact, its ellipse, 700 corners followed forward and backward, displacement since the
contact reached each point, gradients over 1.6 mm, their medians over the contact. What OpenCV's pipeline does, and why
that and nothing else, is at the top of `bench/opencv_pipeline.py`.

ms is a frame's share of the whole call, cpu_ms of its processor time, the columns contact_ms to deformation_ms its
parts in a run after that, and compiled_share what our compiled kernels take of it: less Python cannot spare more than
the rest. Errors are against the exact truth: position_px RMS of the points in the last frame; areas
and axes in percent, RMS over every third frame in which the gross contact has an eighth of its final area or more;
divergence_um_mm at the points of the last frame (what a gauge length flattens is in it); medians over the contact,
RMS over the same frames as areas.

- `process` also writes down what a user keeps: status and uncertainty of every point, labels and units.
- OpenCV's contact is convex by construction (its hull), as the true one is here; fingerflow does not assume it.
"""

import json
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from bench import opencv_pipeline
from bench.drawing import BLUE, RED, saved_axes
from bench.opencv_pipeline import Measured, Rig
from bench.recordings import QUICK_PRESS, write_quietly
from bench.rows import Row, number
from bench.timing import time_in_turns
from fingerflow import load_scene, process
from fingerflow.kernels.kernel import Kernel
from fingerflow.synthetic import Press

PRESS = Press()
#: What fingerflow calls the fields of `Measured`.
OUTPUTS = {
    "real_area": "real_contact_area",
    "gross_area": "gross_contact_area",
    "semi_axes": "ellipse_semi_axes",
    "position": "position_px",
    "divergence": "divergence",
    "median_divergence": "median_divergence",
    "median_strain": "median_strain",
}
PARTS = ("contact", "tracking", "deformation")
PEER = "opencv"


def run(quick: bool) -> list[Row]:
    """Return a row per pipeline."""
    press = QUICK_PRESS if quick else PRESS
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "press"
        write_quietly(recording, press)
        calls = {name: partial(pipeline, recording, press) for name, pipeline in PIPELINES.items()}
        rounds = 2 if quick else 5
        times = time_in_turns(calls, PEER, rounds, time.perf_counter)
        processor = time_in_turns(calls, PEER, rounds, time.process_time)
        measured = {name: call() for name, call in calls.items()}
        compiled = {name: np.median([_share_in_kernels(call) for _ in range(rounds)]) for name, call in calls.items()}
    return [
        {
            "pipeline": name,
            **times[name].of_each(press.n_frames).cells(),
            "cpu_ms": processor[name].of_each(press.n_frames).median_ms,
            "cpu_to_peer": processor[name].to_peer,
            **{f"{part}_ms": 1e3 * measured[name].seconds[part] / press.n_frames for part in PARTS},
            "compiled_share": float(compiled[name]),
            **_errors(measured[name], press),
        }
        for name in PIPELINES
    ]


def _share_in_kernels(call: Callable[[], object]) -> float:
    """Return the share of the processor time of a call that our compiled kernels take."""
    plain, seconds, begin = Kernel.__call__, list[float](), time.process_time()

    def timed(kernel: Kernel, **values: Any) -> Any:
        entered = time.process_time()
        results = plain(kernel, **values)
        seconds.append(time.process_time() - entered)
        return results

    with patch.object(Kernel, "__call__", timed):
        call()
    return sum(seconds) / (time.process_time() - begin)


def opencv_cpu_ms(recording: Path, press: Press) -> float:
    """Return the processor time of one run of OpenCV's pipeline on a recording of a press, ms a frame."""
    start = time.process_time()
    _with_opencv(recording, press)
    return 1e3 * (time.process_time() - start) / press.n_frames


def _with_opencv(recording: Path, press: Press) -> Measured:
    views = press.views
    frames = np.load(recording / "frames.npy")
    empty, dark = (
        np.ascontiguousarray(views["contact"].crop(np.load(recording / f"{name}.npy"))) for name in ("empty", "dark")
    )
    rig = Rig(empty, dark, press.mm_per_px, np.array(press.topography_to_contact))
    contact, topography = (np.ascontiguousarray(views[name].crop(frames)) for name in ("contact", "topography"))
    return opencv_pipeline.run(contact, topography, rig)


def _with_fingerflow(recording: Path, press: Press) -> Measured:
    result = process(load_scene(recording / "scene.toml"), OUTPUTS.values(), device="cpu")
    seconds = json.loads(result.attrs["stage_seconds"])
    return Measured(**{field: result[name].values for field, name in OUTPUTS.items()}, seconds=seconds)


#: Peer first.
PIPELINES: dict[str, Callable[[Path, Press], Measured]] = {PEER: _with_opencv, "fingerflow": _with_fingerflow}


def _errors(measured: Measured, press: Press) -> dict[str, float]:
    truth, last = press.truth, press.n_frames - 1
    gross = np.array([truth.gross_contact_area_mm2(frame) for frame in range(press.n_frames)])
    frames = [frame for frame in range(last, -1, -3) if gross[frame] > gross[-1] / 8]
    ellipses = [ellipse for frame in frames if (ellipse := truth.ellipse(frame)) is not None]
    axes = np.array([sorted(ellipse.semi_axes, reverse=True) for ellipse in ellipses])
    real = np.array([truth.real_contact_area_mm2(frame) for frame in frames])
    medians = [truth.medians(frame) for frame in frames]
    divergence = np.array([true.divergence for true in medians])
    strain = np.array([(true.exx, true.eyy, true.exy) for true in medians])
    material = truth.material(truth.topography_positions(measured.position[0]), 0)
    distance = measured.position[last] - truth.topography_pixels(truth.positions(material, last))
    tracked = np.isfinite(distance).all(-1)
    field = measured.divergence[last] - np.trace(truth.gradient(material, last), axis1=-2, axis2=-1)
    return {
        "tracked": float(tracked.mean()),
        "position_px": float(np.sqrt((distance[tracked] ** 2).sum(-1).mean())),
        "real_area_pct": 100 * _rms(measured.real_area[frames] / real - 1),
        "gross_area_pct": 100 * _rms(measured.gross_area[frames] / gross[frames] - 1),
        "axes_pct": 100 * _rms(measured.semi_axes[frames] / axes - 1),
        "divergence_um_mm": 1e3 * _rms(field[np.isfinite(field)]),
        "median_divergence_um_mm": 1e3 * _rms(measured.median_divergence[frames] - divergence),
        "median_strain_um_mm": 1e3 * _rms(measured.median_strain[frames] - strain),
    }


def _rms(errors: NDArray[np.float64]) -> float:
    return float(np.sqrt((errors**2).mean()))


#: Columns of the figure: quantity, unit and digits.
_DRAWN = {
    "ms": ("time of a frame", "ms", 1),
    "position_px": ("position of a point", "px", 3),
    "real_area_pct": ("real contact area", "%", 2),
    "gross_area_pct": ("gross contact area", "%", 2),
    "axes_pct": ("axes of its ellipse", "%", 2),
    "divergence_um_mm": ("divergence at a point", "µm/mm", 1),
    "median_divergence_um_mm": ("median divergence", "µm/mm", 2),
    "median_strain_um_mm": ("median strain", "µm/mm", 2),
}


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw time and errors as ratios to those of OpenCV's pipeline."""
    ours, peer = (next(row for row in rows if row["pipeline"] == name) for name in ("fingerflow", "opencv"))
    names, ratios = [], []
    for column, (quantity, unit, digits) in _DRAWN.items():
        pair = number(ours, column), number(peer, column)
        names.append(f"{quantity}: {pair[0]:.{digits}f} for {pair[1]:.{digits}f} {unit}")
        ratios.append(pair[0] / pair[1])
    with saved_axes(path, 3, width=7) as (axes,):
        axes.barh(range(len(names)), ratios, color=RED, height=0.55)
        axes.axvline(1, color=BLUE)
        axes.set_yticks(range(len(names)), names)
        axes.invert_yaxis()
        axes.set(xlim=(0, 1.05 * max(1, *ratios)), xlabel="time or error over that of OpenCV's pipeline (blue)")
