"""Errors of stuck area d², verdict and friction ratio mu_k / mu_s on random rendered trials of partial slip.

A trial a seed: mu_s of 0.5 to 1.5, contacts of 4.8 to 5.9 mm in views of 256 x 304 px, a rim that creeps by 0.15 to 0.3
of a semi-axis, camera noise of 1 to 3 grey levels, force noise of 5 to 30 mN, 60 frames a second for 1.6 to 2.4 s.
Points are tracked with windows of 17 px; the rest are default settings. Seven seeds of each of two curves, with each of
five laws by which slip begins beside the stick border (`bench.slip_trials`); one of each with --quick.

- law: of the slip at a distance x from the border. "rounded" is that of `fingerflow.synthetic.PartialSlip`, x^2 up to a
  tenth of the contact and a line from there; "x ln 1/x" that of a half-space whose friction jumps at the border;
- curve: "model", d²(T/N) of equation 5 with mu_k of 0.3 to 1.6 times mu_s; "line", d² that falls in a straight line to
  0.10 to 0.34 and vanishes from there in 130 to 310 ms, the range of Terekhov & Hayward (2011);
- verdict: right where it says "vanishes abruptly" and the true critical area is above 0.05, or "diminishes" and it
  is not; wrong where it says the other; none where it is "inconclusive". `critical` is that area, `critical_found` the
  measured one, `critical_z` its error in its standard deviations, `found` the verdict and `why` its reason; by_area:
  whether the measured area alone, without regard to its evidence, lies on the right side of the limit; by_model,
  as_printed: whether `model_outcome`, `printed_outcome` is right; by_40_um: whether the printed rule is right on the
  printed d², of skin that has moved by less than 40 um;
- duration_error: s, duration of the collapse less the true one, of trials that vanish abruptly and are judged to;
- bias, rms: of the error of d², over the frames with a true d² of 0.03 to 0.97; z: the error in its stated standard
  deviations, RMS; within_1, within_2: percent of these frames whose error is at most one, two of them. `power` is the
  fitted one. `bias_40_um` and `worst_40_um`: by how much the printed d² exceeds the share that has not slipped, on
  average and at most; `rms_40_um`: its error as the share of skin that has moved by less than 40 um;
- within_002: percent of the frames before full slip whose d² is off by 0.02 at most; `worst` the largest error,
  `unknown` the percent of these frames without a d²;
- ratio_error: mu_k / mu_s over the true one, less 1, from the critical area of a trial of the model that vanishes
  abruptly and is judged to; `fit_error` the same from the friction law fitted to d²(T/N), where the fit says that it is
  identified;
- cpu_s: of `process`, one thread.

The rows without a seed sum up all trials, those of a curve, and those of a law: counts of verdicts, percent of all
frames, the worst of all, RMS of z, and the percent of the trials with a ratio whose `ratio_error` (`fit_error`) is 5 %
at most; of power the median. In pictures of real fingers slip may begin by yet another
law.
"""

import json
import math
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.drawing import GREY, RED, Mark, saved_axes
from bench.environment import one_thread
from bench.recordings import write_quietly
from bench.rows import Cell, Row, number
from bench.slip_trials import LAWS, LawSlip
from fingerflow import load_scene, process
from fingerflow.models.partial_slip import critical_stuck_area, judge_trial
from fingerflow.models.partial_slip.verdict import SMALLEST_AREA
from fingerflow.synthetic import Camera, RidgeTexture

SEEDS = range(204, 211)  # not those that constants of the pipeline were chosen on, 100 to 105 and 200 to 203
CURVES = ("model", "line")
_ORDER = ("wrong", "none", "right")
_NEAR = 0.02  # of d^2
_CLOSE = 0.05  # of mu_k / mu_s
_RATE = 60.0
_PARTIAL = 0.03  # least share that sticks, and that slips, in the frames whose error is compared with its deviation


def run(quick: bool) -> list[Row]:
    """Return a row of all trials, of each curve and of each law, then a row per trial, the wrong verdicts first."""
    seeds = SEEDS[:1] if quick else SEEDS
    rows = [
        measured(f"{law}, {curve}, {seed}", trial(seed, law, curve))
        for law in LAWS
        for curve in CURVES
        for seed in seeds
    ]
    groups = {"all": rows}
    for key, names in (("curve", CURVES), ("law", LAWS)):
        groups |= {name: [row for row in rows if row[key] == name] for name in names}
    return [
        *(summed(some, name) for name, some in groups.items()),
        *sorted(rows, key=lambda row: _ORDER.index(str(row["verdict"]))),
    ]


def trial(seed: int, law: str = "rounded", curve: str = "model") -> LawSlip:
    """Return the random trial of a seed, with a law of slip beside the border and a curve d²(T/N)."""
    draw = np.random.default_rng(seed)
    static = draw.uniform(0.5, 1.5)
    length = draw.uniform(2.4, 2.95)
    width = length * draw.uniform(0.75, 0.95)
    model = LawSlip(
        n_frames=int(_RATE * draw.uniform(1.6, 2.4)),
        frame_rate=_RATE,
        frames_before_trigger=6,
        frame_shape=(256, 608),
        finger=(1.3 * length, 1.3 * width),
        semi_axes=(length, width),
        tilt=draw.uniform(-0.5, 0.5),
        direction=draw.uniform(-math.pi, math.pi),
        creep=length * draw.uniform(0.15, 0.3),
        travel=draw.uniform(0.6, 1.4),
        full_slip=draw.uniform(0.65, 0.8),
        collapse=draw.uniform(0.13, 0.31),
        static_friction=static,
        kinetic_friction=static * draw.uniform(0.3, 1.6),
        force=draw.uniform(1.0, 3.0),
        force_noise=draw.uniform(0.005, 0.03),
        camera=Camera(noise=draw.uniform(1.0, 3.0), seed=seed),
        texture=RidgeTexture(centre=(draw.uniform(-0.8, 0.8), draw.uniform(-1.2, 0.0))),
        law=law,
    )
    if curve == "model":
        return model
    draw = np.random.default_rng(seed + 1000)
    return replace(
        model,
        kinetic_friction=static * draw.uniform(0.5, 0.9),
        linear=True,
        last=draw.uniform(0.10, 0.34),
        collapse=draw.uniform(0.13, 0.31),
    )


def measured(name: str, known: LawSlip) -> dict[str, Cell]:
    """Render and process a trial; return its row."""
    with tempfile.TemporaryDirectory() as folder, one_thread():
        write_quietly(Path(folder) / "trial", known)
        scene = load_scene(Path(folder) / "trial" / "scene.toml")
        tracking = replace(scene.tracking, points=600, window_px=17, min_distance_px=4.0)
        begun = time.process_time()
        names = ["stuck_ratio", "stuck_ratio_std", "printed_stuck_ratio", "load_ratio"]
        result = process(replace(scene, tracking=tracking), names, device="cpu")
        seconds = time.process_time() - begun
    frames = range(known.n_frames)
    share, slow = (np.array([of(frame) for frame in frames]) for of in (known.stuck_share, known.slow_share))
    ratio, deviation, printed, load = (result[one].values for one in names)
    error = np.abs(ratio - share)[share > 0]
    found = error[np.isfinite(error)]
    partial = (share > _PARTIAL) & (share < 1 - _PARTIAL) & np.isfinite(ratio)
    off = (ratio - share)[partial]
    normal = off / deviation[partial]
    above = (printed - share)[partial]
    stored = result["stuck_ratio"].attrs
    verdict, fit = json.loads(stored["verdict"]), json.loads(stored.get("friction_fit", "{}"))
    follows_model = not known.linear
    critical = float(critical_stuck_area(known.static_friction, known.kinetic_friction).nan_to_num(0.0))
    if known.linear:
        critical = known.last
    abrupt = critical > SMALLEST_AREA
    outcome = "vanishes abruptly" if abrupt else "diminishes"
    right = verdict["outcome"] == outcome
    judged = "none" if verdict["outcome"] == "inconclusive" else "right" if right else "wrong"
    true_ratio = known.kinetic_friction / known.static_friction
    friction = verdict["friction_ratio"] if abrupt and right and follows_model else None
    fitted = fit["ratio"] if abrupt and follows_model and fit.get("identified") else None
    area = verdict["critical_area"]
    return {
        "trial": name,
        "law": known.law,
        "curve": "model" if follows_model else "line",
        "verdict": judged,
        "by_area": area is not None and (area > SMALLEST_AREA) == abrupt,
        "by_model": verdict["model_outcome"] == outcome,
        "as_printed": verdict["printed_outcome"] == outcome,
        "by_40_um": judge_trial(printed, load, result["time"].values).printed_outcome == outcome,
        "found": verdict["outcome"],
        "critical": critical,
        "critical_found": area,
        "critical_z": None if area is None else (area - critical) / verdict["critical_area_std"],
        "duration_error": verdict["collapse_ms"] / 1000 - known.collapse if abrupt and right else None,
        "noise": known.camera.noise,
        "power": stored.get("power"),
        "bias": float(off.mean()),
        "rms": _rms(off),
        "z": _rms(normal) if np.isfinite(normal).all() else None,
        "within_1": 100 * float((np.abs(normal) <= 1).mean()),
        "within_2": 100 * float((np.abs(normal) <= 2).mean()),
        "bias_40_um": float(np.nanmean(above)),
        "worst_40_um": float(np.nanmax(above)),
        "rms_40_um": _rms((printed - slow)[partial]),
        "frames": len(error),
        "unknown": 100 * float(1 - len(found) / len(error)),
        "within_002": 100 * float((found <= _NEAR).mean()) if len(found) else None,
        "worst": float(found.max()) if len(found) else None,
        "ratio_error": None if friction is None else friction / true_ratio - 1,
        "fit_error": None if fitted is None else fitted / true_ratio - 1,
        "cpu_s": seconds,
        "why": verdict["reason"],
    }


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def summed(rows: Sequence[Mapping[str, Cell]], name: str) -> Row:
    """Return the row that sums up those of some trials."""
    known = [row for row in rows if row["within_002"] is not None]
    frames = sum(number(row, "frames") for row in rows)
    seen = [number(row, "frames") * (1 - number(row, "unknown") / 100) for row in known]
    near = sum(count * number(row, "within_002") for count, row in zip(seen, known, strict=True))

    def numbers(key: str) -> list[float]:
        return [number(row, key) for row in rows if row[key] is not None]

    def combined(key: str, how: Callable[[list[float]], float]) -> float | None:
        there = numbers(key)
        return float(how(there)) if there else None

    def root(values: list[float]) -> float:
        return math.sqrt(float(np.mean(np.square(values))))

    def close(values: list[float]) -> float:
        return 100 * float(np.mean(np.abs(values) <= _CLOSE))

    means = {key: combined(key, np.mean) for key in ("bias", "within_1", "within_2", "bias_40_um")}
    roots = {key: combined(key, root) for key in ("critical_z", "rms", "z", "rms_40_um", "duration_error")}
    counts = {key: sum(bool(row[key]) for row in rows) for key in ("by_area", "by_model", "as_printed", "by_40_um")}
    return {
        "trial": name,
        "verdict": ", ".join(f"{sum(row['verdict'] == one for row in rows)} {one}" for one in _ORDER),
        "found": f"of {len(rows)}",
        **counts,
        **means,
        **roots,
        "worst_40_um": combined("worst_40_um", max),
        "frames": int(frames),
        "unknown": 100 * (1 - sum(seen) / frames),
        "within_002": near / sum(seen) if seen else None,
        "worst": max((number(row, "worst") for row in known), default=None),
        **{key: combined(key, close) for key in ("ratio_error", "fit_error")},
        "power": combined("power", np.median),
        "cpu_s": sum(number(row, "cpu_s") for row in rows),
    }


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw the measured critical area of each trial against the true one, and the error of d² by law."""
    trials = [row for row in rows if "critical_found" in row]
    colours = {"right": RED, "wrong": "black", "none": GREY}
    with saved_axes(path, 3.6, 2) as (left, right):
        for verdict, colour in colours.items():
            mine = [row for row in trials if row["verdict"] == verdict and row["critical_found"] is not None]
            if mine:
                found = [[number(row, column) for row in mine] for column in ("critical", "critical_found")]
                left.plot(*found, linestyle="", label=f"verdict {verdict}: {len(mine)}", **Mark(colour).style)
        left.axline((0, 0), slope=1, color="0.65", linewidth=0.8, zorder=0)
        for line in (left.axhline, left.axvline):
            line(SMALLEST_AREA, color="0.65", linewidth=0.8, linestyle=":", zorder=0)
        left.set(xlabel="true critical area (share of the contact)", ylabel="measured critical area")
        left.legend(frameon=False)
        laws = list(dict.fromkeys(str(row["law"]) for row in trials))
        errors = [[number(row, "rms") for row in trials if row["law"] == law] for law in laws]
        for row, values in enumerate(errors):
            right.plot(values, [row] * len(values), linestyle="", alpha=0.5, **Mark(RED).style)
        right.set_yticks(range(len(laws)), laws)
        right.invert_yaxis()
        right.set(xlabel="RMS error of the stuck share d² in a trial", ylabel="law of slip", xlim=(0, None))
