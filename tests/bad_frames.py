"""`python -m tests.bad_frames`: the shipped press and slide with frames that cannot be, recorded and live.

Each kind of bad frame is put at ten places, one in each tenth of the recording and, of the tenth with the largest
force, in that frame; places are drawn by a seeded generator and are the same for all kinds. The recording is processed,
or played by the compiled library, and compared with the clean one: the bad frames by their status and by NaN, all other
frames by how far each number is from the clean run's, over the stated deviation, the larger of both runs' (areas, which
state none: in per cent of the largest). A number is wrong that is further off than three times that deviation, an area
that is off by more than the tests allow, and one that is missing where the clean run has it, unless the status of the
point, or for a median `field_coverage`, says why.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import logging
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fingerflow import load_scene, player, process
from fingerflow.export.recipe import load_recipe
from fingerflow.schema.variables import FRAME_STATUS, TRACK_STATUS
from fingerflow.synthetic import Press, Slide, write_recording
from fingerflow.synthetic.scenes import SyntheticScene
from tests.small_trials import SPOILED, write_library_bundle

__all__ = ["KINDS", "TRIALS", "WAYS", "look", "main"]
Array = NDArray[Any]
PLACES = 10
TRIALS: dict[str, Callable[[], SyntheticScene]] = {"press": Press, "slide": Slide}  # as shipped
WAYS = ("recorded", "live")
RECIPE = Path(__file__).resolve().parents[1] / "export" / "exact.toml"
USABLE = FRAME_STATUS.index("usable")
TRACKED, FRAME_NOT_USABLE = (TRACK_STATUS.index(name) for name in ("tracked", "frame_not_usable"))
FAR = 3.0  # stated deviations
AREAS = ("real_contact_area", "gross_contact_area", "contact_threshold")
AREA_LIMITS = {"recorded": 5e-3, "live": 0.02}  # of the threshold of another frame: tests/stages, tests/player
OF_POINTS = ("position_px", "divergence")
NUMBERS = ("median_divergence", "median_curl", "strain_energy", *AREAS, *OF_POINTS)
DEVIATIONS = {name: f"{name}_std" for name in NUMBERS if name not in AREAS} | {"position_px": "position_std_px"}
LEAST_COVERAGE = 0.85  # of fields, below which a median is NaN: `field_coverage`
# By which a position may change with where it was looked for, and with when its template was renewed
# (tests/test_engines_agree.py).
LEAST = {"position_px": 0.01}


def _others(spoil: Callable[[Array], Array]) -> Callable[[Array, int, np.random.Generator], Array]:
    return lambda frames, k, _: spoil(frames[k])


def _dim_topography(frame: Array) -> Array:
    middle = frame.shape[1] // 2
    return np.concatenate([(0.7 * frame[:, :middle]).astype(frame.dtype), frame[:, middle:]], axis=1)


#: What becomes of frame k of all.
KINDS: dict[str, Callable[[Array, int, np.random.Generator], Array]] = {
    **{name: _others(spoil) for name, (spoil, _) in SPOILED.items()},
    "dim topography": _others(_dim_topography),
    "noise": lambda frames, k, rng: rng.integers(0, 256, frames[k].shape).astype(frames.dtype),
    "repeated": lambda frames, k, _: frames[k - 1],
    "other moment": lambda frames, k, _: frames[(k + len(frames) // 2) % len(frames)],
}


@dataclass(frozen=True)
class Run:
    """Numbers of a recording, by name; frames and points come first in each."""

    status: Array  # (F,) of the frames
    of_point: Array  # (F, P)
    numbers: dict[str, Array]


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bad_frames", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trial", choices=TRIALS, action="append", help="only this one; may be repeated")
    parser.add_argument("--way", choices=WAYS, action="append", help="only this one; may be repeated")
    parser.add_argument("--kind", choices=KINDS, action="append", help="only this one; may be repeated")
    parser.add_argument("--seed", type=int, default=16)
    asked = parser.parse_args(arguments)
    wrong = 0
    with tempfile.TemporaryDirectory(prefix="bad-frames-") as made:
        for trial in asked.trial or TRIALS:
            folder = Path(made) / trial
            _write(folder, TRIALS[trial]())
            for way in asked.way or WAYS:
                wrong += look(folder, way, asked.kind or list(KINDS), asked.seed)
            shutil.rmtree(folder)
    print(f"{wrong} numbers wrong")
    return 1 if wrong else 0


def look(folder: Path, way: str, kinds: list[str], seed: int) -> int:
    """Prints a line a kind; how many numbers were wrong."""
    frames = np.load(folder / "clean.npy", mmap_mode="r")
    stated = _stated(folder, frames)
    rng = np.random.default_rng(seed)
    places = _places(len(frames), int(np.nanargmax(stated.numbers["normal_force"])), rng)
    clean = stated if way == "recorded" else _run(folder, way, frames)
    names = [one for one in NUMBERS if one in clean.numbers]
    print(f"{folder.name}, {way}: {len(frames)} frames, {clean.of_point.shape[1]} points, bad: {places.tolist()}")
    print(f"the clean run has {int((clean.status != USABLE).sum())} bad frames")
    print(f"{'':17}{'found':>6}{'more':>6}{'told':>6}{'lost':>8}" + "".join(f"{one:>24}" for one in names))
    wrong = 0
    for kind in kinds:
        spoiled = np.array(frames)
        for k in places:
            spoiled[k] = KINDS[kind](frames, k, rng)
        columns, more = _compare(clean, _run(folder, way, spoiled), stated, places, names, AREA_LIMITS[way])
        wrong += more
        print(f"{kind:17}{columns}", flush=True)
    return wrong


def _write(folder: Path, scene: SyntheticScene) -> None:
    """As `fingerflow simulate` does."""
    with _quiet(folder.with_suffix(".log")):
        write_recording(folder, scene)
    (folder / "frames.npy").rename(folder / "clean.npy")


def _stated(folder: Path, frames: Array) -> Run:
    """`process` of the clean recording, once."""
    kept = folder / "stated.npz"
    if not kept.exists():
        run = _run(folder, "recorded", frames)
        arrays: dict[str, Any] = {"status": run.status, "of_point": run.of_point, **run.numbers}
        np.savez(kept, **arrays)
    with np.load(kept) as stored:
        numbers = dict(stored)
    return Run(numbers.pop("status"), numbers.pop("of_point"), numbers)


def _places(frames: int, largest: int, rng: np.random.Generator) -> Array:
    """One in each tenth, none beside another, not in the first frame; of the tenth with the largest force, there."""
    tenths = np.linspace(0, frames, PLACES + 1).round().astype(int)
    places = np.array([rng.integers(first + 2, end - 2) for first, end in itertools.pairwise(tenths)])
    places[np.searchsorted(tenths, largest, side="right") - 1] = np.clip(largest, 2, frames - 3)
    return places


def _run(folder: Path, way: str, frames: Array) -> Run:
    """A recording of these frames, processed or played."""
    np.save(folder / "frames.npy", frames)
    with _quiet(folder / "log"):
        if way == "recorded":
            result = process(load_scene(folder / "scene.toml"))
            names = (*NUMBERS, *DEVIATIONS.values(), "normal_force", "field_coverage")
            return Run(
                result["frame_status"].values, result["status"].values, {name: result[name].values for name in names}
            )
        bundle, output = folder.parent / "bundle", folder / "played"
        if not bundle.exists():
            write_library_bundle(bundle, load_recipe(RECIPE))
        shutil.rmtree(output, ignore_errors=True)
        files = ["--scene", str(folder / "scene.toml"), "--source", str(folder / "frames.npy"), "--output", str(output)]
        assert player.main([str(bundle), *files, "--page", "off", "--threads", "1"]) == 0
        records = player.read_results(output).records
        numbers = {
            name: np.array(records[name]) for name in (*NUMBERS, "restart") if name in (records.dtype.names or ())
        }
        return Run(np.array(records["frame_status"]), np.array(records["status"]), numbers)


@contextlib.contextmanager
def _quiet(log: Path) -> Iterator[None]:
    """What is said goes to a file."""
    with log.open("a") as file, contextlib.redirect_stdout(file), contextlib.redirect_stderr(file):
        logging.disable()
        yield
        logging.disable(logging.NOTSET)


def _compare(clean: Run, run: Run, stated: Run, places: Array, names: list[str], area_limit: float) -> tuple[str, int]:
    """The columns of a kind, and how many numbers are wrong in it."""
    found = run.status[places] != USABLE
    others = np.setdiff1d(np.arange(len(run.status)), places)
    more = int((run.status[others] != USABLE).sum())
    # In a frame that was found there is no number; in one that was not, each is as in the other frames, or wrong.
    there = {name: np.isfinite(run.numbers[name][places[found]]) for name in names}
    told = not any(values.any() for values in there.values())
    told &= bool((run.of_point[places[found]] == FRAME_NOT_USABLE).all())
    wrong = more + sum(int(values.sum()) for values in there.values())
    counted = np.sort(np.concatenate((others, places[~found])))
    same = _same_points(clean, run)
    before, after = clean.of_point[counted][:, same] == TRACKED, run.of_point[counted][:, same] == TRACKED
    columns = f"{int(found.sum()):6}{more:6}{'yes' if told else 'NO':>6}{1 - after[before].mean():8.1%}"
    for name in names:
        column, more = _off(name, clean, run, stated, counted, same, area_limit)
        columns, wrong = columns + column, wrong + more
    return columns, wrong


def _same_points(clean: Run, run: Run) -> NDArray[np.bool_]:
    """(P,) points that both runs chose in the same place: others are other points."""
    first, other = clean.numbers["position_px"][0], run.numbers["position_px"][0]
    same: NDArray[np.bool_] = np.isfinite(first).all(-1) & (first == other).all(-1)
    if "restart" in clean.numbers and (clean.numbers["restart"] != run.numbers["restart"]).any():
        return np.zeros_like(same)
    return same


def _off(
    name: str, clean: Run, run: Run, stated: Run, counted: Array, same: NDArray[np.bool_], area_limit: float
) -> tuple[str, int]:
    """One column, "worst (wrong)", and how many are wrong."""
    before, after = clean.numbers[name][counted], run.numbers[name][counted]
    if name in AREAS:
        off = np.abs(after - before) / np.nanmax(np.abs(before))
        missing = np.isnan(after) & np.isfinite(before)
        wrong = int((off > area_limit).sum() + missing.sum())
        return f"{np.nanmax(off, initial=0):17.2%} ({wrong:4})", wrong
    own = run.numbers.get(DEVIATIONS[name], stated.numbers[DEVIATIONS[name]])
    deviation = np.fmax(stated.numbers[DEVIATIONS[name]], own)[counted]
    if name in OF_POINTS:
        before, after, deviation = before[:, same], after[:, same], deviation[:, same]
        missing = (run.of_point[counted][:, same] == TRACKED) & (name == "position_px")
        if before.ndim == 3:
            missing &= np.isnan(after).any(-1)
            before, after = np.moveaxis(before, -1, 0), np.moveaxis(after, -1, 0)
    else:
        missing = np.isnan(after) & np.isfinite(before)
        if name.startswith("median") and "field_coverage" in run.numbers:
            missing &= run.numbers["field_coverage"][counted] >= LEAST_COVERAGE
    off = np.abs(after - before)
    least = LEAST.get(name, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = off / np.hypot(deviation, least / FAR)
    ratio = np.where(off <= least, 0, ratio)
    wrong = int((ratio > FAR).sum() + missing.sum())
    return f"{np.nanmax(ratio, initial=0):17.2f} ({wrong:4})", wrong


if __name__ == "__main__":
    sys.exit(main())
