"""Errors of d', area under the ROC and criterion over twenty simulated studies that are processed from images.

A study is a `fingerflow.study.simulated_trials.Design`: 8 participants, 7 amplitudes, a comparison press each, of 4 to
9 N, in views of 418 px at 20 frames a second; default settings otherwise. An observer feels the divergence, another the
real contact area of the same presses: more or less of it than in the reference press, whose pictures are not needed.
The answers follow from the truth, the metrics from the pictures by `process` and the table of a study.

- d_prime, auc, criterion: of the felt metric, with their intervals of 95 % by participant; `true` is that of 56,000
  trials of the same design, by their truth, without pictures;
- correct, measured: right answers, and presses whose felt metric was measured (a trial that fails has none);
- holds: whether the three intervals contain the truth;
- best, best_by_auc: which of the paper's seven metrics (figure S11) tells answers best, by |d'| and by |area - 1/2|.
  Strain energy and strain rate rise with the divergence: by ranks, which the area goes by, they can come as near to
  it as chance among 56 trials reaches.

Rows `all` count studies. The metrics of every press are kept in `results/simulated_studies.csv`, so that an interrupted
run goes on. One stored press of each study is measured again: if its metrics differ, because the renderer or the
pipeline has changed since, all presses of that study are measured again.
"""

import csv
import hashlib
import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from bench.environment import one_thread
from bench.rows import Cell, Row
from fingerflow import load_scene, process
from fingerflow.errors import FingerflowError
from fingerflow.models.observer import Trials, leave_out_moved, observe
from fingerflow.report.supplement import OBSERVED
from fingerflow.schema.trial_columns import NUMBERS
from fingerflow.study.row import measure
from fingerflow.study.simulated_trials import Design, Felt, Presses, answers_of, draw_presses, recording_of
from fingerflow.synthetic import write_recording

STUDIES = 20
DESIGN = Design(
    participants=8, trials=1, softness=(3.15, 3.8), force_range=(4.0, 9.0), real_area=(23.7, 4.5), noise=(0.008, 3.0),
    view_px=418,
)  # fmt: skip
STORE = Path(__file__).parents[1] / "results" / "simulated_studies.csv"
FELT: tuple[Felt, ...] = ("divergence", "real_contact_area")
STATISTICS = ("d_prime", "auc", "criterion")
_POPULATION = replace(DESIGN, participants=2000, trials=4, seed=1_000_000)
_RESAMPLES = 2000
_ROUNDING = 1e-5  # relative difference of metrics that six stored digits allow


def run(quick: bool) -> list[Row]:
    """Return a row of all studies for each observer, and a row per study and observer."""
    design = replace(DESIGN, participants=4, amplitudes=(0.0, 1.0, 3.0)) if quick else DESIGN
    truths = truth_of(replace(_POPULATION, amplitudes=design.amplitudes))
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder) / STORE.name if quick else STORE
        for seed in range(1 if quick else STUDIES):
            own = replace(design, seed=seed)
            metrics = measured(own, store)
            rows += [row_of(replace(own, feels=felt), metrics, truths[felt]) for felt in FELT]
    return [*(summed(felt, rows) for felt in FELT), *rows]


def measured(design: Design, store: Path) -> dict[str, NDArray[np.float64]]:
    """Return the metrics of the comparison presses of a study; those not in the store are rendered and processed."""
    presses = draw_presses(design).pairs()[1]
    count = presses.force.size
    with one_thread():
        known = _valid(store, design, presses)
        left = [number for number in range(count) if number not in known]
        for number in tqdm(left, desc=f"study {design.seed}", unit="press"):
            known[number] = _metrics(design, presses, number)
            _keep(store, design, number, known[number])
    return {name: np.array([known[number][name] for number in range(count)]) for name in OBSERVED}


def row_of(design: Design, metrics: dict[str, NDArray[np.float64]], truth: dict[str, float]) -> Row:
    """Return the row of a study and its observer."""
    reference, comparison = draw_presses(design).pairs()
    trials = Trials(
        participant=comparison.participant,
        trial=np.arange(comparison.participant.size),
        condition=comparison.amplitude,
        answer=answers_of(design, reference, comparison),
        metrics=metrics,
    )
    found = observe(leave_out_moved(trials), resamples=_RESAMPLES)
    by_d_prime = {name: abs(one.d_prime.value) for name, one in found.items()}
    by_auc = {name: abs(one.auc.value - 0.5) for name, one in found.items()}
    row: dict[str, Cell] = {
        "study": str(design.seed),
        "feels": design.feels,
        "best": max(by_d_prime, key=by_d_prime.__getitem__),
        "best_by_auc": max(by_auc, key=by_auc.__getitem__),
        "correct": int(trials.answer.sum()),
        "measured": int(np.isfinite(metrics[design.feels]).sum()),
    }
    for name in STATISTICS:
        one = getattr(found[design.feels], name)
        factor = float(NUMBERS[design.feels].shown_values(1.0)) if name == "criterion" else 1.0
        low, high = one.interval
        known = {name: one.value, f"{name}_low": low, f"{name}_high": high, f"{name}_true": truth[name]}
        row |= {key: _cell(factor * value) for key, value in known.items()}
        row[f"{name}_holds"] = low <= truth[name] <= high
    return row


def summed(felt: Felt, rows: list[Row]) -> Row:
    """Return the numbers of studies in which the felt metric is the best, and in which intervals hold the truth."""
    own = [row for row in rows if row["feels"] == felt]
    found: dict[str, Cell] = {"study": f"all {len(own)}", "feels": felt}
    for name in ("best", "best_by_auc"):
        found[name] = f"{felt} in {sum(row[name] == felt for row in own)}"
    for name in STATISTICS:
        found[f"{name}_true"] = own[0][f"{name}_true"]
        found[f"{name}_holds"] = sum(bool(row[f"{name}_holds"]) for row in own)
    return found


def truth_of(design: Design) -> dict[Felt, dict[str, float]]:
    """Return the true statistics of each observer, from many trials of a design by their truth."""
    reference, comparison = draw_presses(design).pairs()
    found: dict[Felt, dict[str, float]] = {}
    for felt in FELT:
        answers = answers_of(replace(design, feels=felt), reference, comparison)
        values = getattr(comparison, felt)
        correct, incorrect = values[answers], np.sort(values[~answers])
        apart = correct.mean() - incorrect.mean()
        found[felt] = {
            "d_prime": float(apart / math.sqrt((correct.var() + incorrect.var()) / 2)),
            "auc": float(np.searchsorted(incorrect, correct).mean() / incorrect.size),
            "criterion": float(np.quantile(correct, 0.25)),
        }
    return found


def _cell(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _metrics(design: Design, presses: Presses, number: int) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        write_recording(Path(folder) / "press", recording_of(design, presses, number), progress=False)
        try:
            row, _ = measure(process(load_scene(Path(folder) / "press" / "scene.toml"), device="cpu"))
        except FingerflowError:  # a failed trial of a study: ridges too thin to be told from the noise
            row = dict.fromkeys(OBSERVED)
    return {name: math.nan if row[name] is None else float(row[name]) for name in OBSERVED}


def _valid(store: Path, design: Design, presses: Presses) -> dict[int, dict[str, float]]:
    """Return the stored metrics of a study by number of the press, if one of its presses, measured again, still has
    them.

    Otherwise the study is removed from the store, and the new metrics of that press are returned.
    """
    known = _stored(store, design)
    if not known:
        return known
    number = min(known)
    now = _metrics(design, presses, number)
    before, after = ([one[name] for name in OBSERVED] for one in (known[number], now))
    if np.allclose(before, after, rtol=_ROUNDING, atol=0, equal_nan=True):
        return known
    _remove(store, design)
    _keep(store, design, number, now)
    return {number: now}


def _stored(store: Path, design: Design) -> dict[int, dict[str, float]]:
    """Return the stored metrics of a study by number of the press."""
    return {
        int(row["press"]): {name: float(row[name]) for name in OBSERVED} for row in _lines(store) if _is_of(row, design)
    }


def _is_of(row: dict[str, str], design: Design) -> bool:
    return row["study"] == str(design.seed) and row["design"] == _mark(design)


def _lines(store: Path) -> Iterator[dict[str, str]]:
    if store.exists():
        with store.open(encoding="utf-8", newline="") as file:
            yield from csv.DictReader(file)


def _mark(design: Design) -> str:
    """Return a short digest of what decides the pictures: presses of another design are not taken from the store."""
    pictures = replace(design, seed=0, feels=FELT[0], noise=(0.0, 0.0))
    return hashlib.sha256(repr(pictures).encode()).hexdigest()[:8]


def _remove(store: Path, design: Design) -> None:
    """Remove all presses of a study from the store."""
    others = [row for row in _lines(store) if not _is_of(row, design)]
    store.unlink()
    _append(store, others)


def _keep(store: Path, design: Design, number: int, metrics: dict[str, float]) -> None:
    row: dict[str, Any] = {"design": _mark(design), "study": design.seed, "press": number}
    _append(store, [row | {name: f"{value:.6g}" for name, value in metrics.items()}])


def _append(store: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    begun = store.exists()
    with store.open("a", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, ("design", "study", "press", *OBSERVED), lineterminator="\n")
        if not begun:
            writer.writeheader()
        writer.writerows(rows)
