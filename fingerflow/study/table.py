"""Write the table of trials of a study and the curves averaged by condition, from the stored rows of all trials."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from fingerflow.errors import FingerflowError
from fingerflow.results.atomic_write import write_atomically
from fingerflow.schema.trial_columns import BY_SHARE, DIFFERENCE, DIFFERENCES, FACTS, NORMALISED, NUMBERS, UNLOADING
from fingerflow.study.manifest import REFERENCE, Manifest, TrialEntry, frames_of, relative
from fingerflow.study.row import CURVES, FORCE_GRID, SHARE_GRID
from fingerflow.study.spreadsheet_cell import quoted_cell
from fingerflow.study.trial_files import MEASURED, TrialRow, read_row

NOT_RUN = "not run"
_LEVEL = 0.95
_CURVE_COLUMNS = [
    "metric", "unit", "condition", "normal_force_N", "load_share", "mean", "standard_error", "low", "high",
    "participants", "trials", "without",
]  # fmt: skip
# Least share of a condition's trials that must reach a force: with fewer, their mean would be that of a selection.
_MOST_MISSING = 0.5


def write_tables(manifest: Manifest) -> tuple[Path, Path]:
    """Write a study's `trials.parquet` and `trials.csv` (row per trial), `variables.csv` and `curves.csv`; return the
    paths of the first and the last.

    Every trial of the manifest has a row; a failed one has its reason and no numbers, one not yet run has neither.

    Raises FingerflowError if pandas or pyarrow is not installed, or a file cannot be written.
    """
    try:
        import pandas as pd
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as error:
        raise FingerflowError(
            f"the table of trials needs pandas and pyarrow ({error}): pip install pandas pyarrow statsmodels"
        ) from error
    stored = [(entry, read_row(manifest.results / entry.name)) for entry in manifest.trials]
    frame = pd.DataFrame(table_rows(manifest, stored))
    frame = frame.assign(**normalised(frame))
    frame = pd.concat((frame, pd.DataFrame(differences(frame))), axis=1)
    folder = manifest.results
    trials_path, curves_path = folder / "trials.parquet", folder / "curves.csv"
    table = pa.Table.from_pandas(frame, preserve_index=False)
    described = NUMBERS | FACTS | DIFFERENCES
    about = {name: {"units": column.units, "long_name": column.long_name} for name, column in described.items()}
    fields = [column.with_metadata(about.get(column.name)) for column in table.schema]
    table = table.cast(pa.schema(fields, metadata=table.schema.metadata))
    write_atomically(trials_path, lambda part: parquet.write_table(table, part))
    write_atomically(folder / "trials.csv", lambda part: frame.map(quoted_cell).to_csv(part, index=False))
    variables = pd.DataFrame(
        [(column.name, column.units, column.long_name) for column in described.values() if column.name in frame],
        columns=["column", "unit", "definition"],
    )
    write_atomically(folder / "variables.csv", lambda part: variables.to_csv(part, index=False))
    # The column names keep the heading of an empty table.
    curves = pd.DataFrame(averaged(stored), columns=_CURVE_COLUMNS)
    write_atomically(curves_path, lambda part: curves.map(quoted_cell).to_csv(part, index=False))
    return trials_path, curves_path


def table_rows(manifest: Manifest, stored: Sequence[tuple[TrialEntry, TrialRow | None]]) -> list[dict[str, Any]]:
    """Return one row of the study's table for each trial and its stored outcome: columns of the manifest, status and
    files, and measured numbers, NaN where unknown.
    """
    numeric = all(np.isfinite(_parse_number(entry.condition)) for entry, _ in stored)
    rows = []
    for entry, trial in stored:
        measured = trial.row if trial is not None and trial.status == MEASURED else {}
        result = None if trial is None or trial.result is None else manifest.results / entry.name / trial.result
        facts = {
            "status": NOT_RUN if trial is None else trial.status,
            "reason": "" if trial is None else trial.reason,
            "recording": relative(frames_of(entry, manifest.path), manifest.path.parent),
            "result": None if result is None else relative(result, manifest.path.parent),
            **{name: measured.get(name) for name in ("slip_verdict", "frames", "usable_frames", "warnings")},
        }
        numbers = {name: np.nan if measured.get(name) is None else float(measured[name]) for name in NUMBERS}
        condition = float(entry.condition) if numeric else entry.condition
        row = {"participant": entry.participant, "trial": entry.trial, "condition": condition, "answer": entry.answer}
        rows.append(row | dict(entry.extra) | facts | numbers)
    return rows


def normalised(frame: Any) -> dict[str, Any]:
    """Return, as new columns of the table of trials, the contact areas, each divided by the median over all trials of
    its participant; NaN where unknown.
    """
    columns = {}
    for name in NORMALISED:
        median = frame.groupby("participant")[name].transform("median")
        columns[f"{name}_normalised"] = frame[name] / median.where(median > 0)
    return columns


def differences(frame: Any) -> dict[str, Any]:
    """Return the columns named in `DIFFERENCES`: each metric of a trial minus that of the reference trial with which it
    was compared; {} if the table of trials names no references.

    It is NaN for trials without reference, as the references themselves.
    """
    if REFERENCE not in frame or not frame[REFERENCE].any():
        return {}
    # A reference must be the only trial of its number. No trial has an empty number, so trials without a reference find
    # none.
    numbered = frame.drop_duplicates(["participant", "trial"], keep=False).set_index(["participant", "trial"])
    references = list(zip(frame["participant"], frame[REFERENCE], strict=True))
    numbers = [name.removesuffix(DIFFERENCE) for name in DIFFERENCES]
    return {f"{name}{DIFFERENCE}": frame[name] - numbered[name].reindex(references).to_numpy() for name in numbers}


def averaged(stored: Sequence[tuple[TrialEntry, TrialRow | None]]) -> list[dict[str, Any]]:
    """Return the curves of metrics against normal force, or against a share of the load (`BY_SHARE`), averaged over the
    participants of each condition, as table rows: one per metric, condition and force or share.

    The mean is that of the participants' means, with its standard error and a 95 % interval by Student's t from their
    spread: participants are the units, because their trials are not independent. Both are NaN for fewer than two
    participants. A force that fewer than half of a condition's trials reach is left out: its mean would be that of a
    selection.
    """
    import pandas as pd

    rows: list[dict[str, Any]] = []
    conditions = sorted({entry.condition for entry, _ in stored}, key=lambda text: (_parse_number(text), text))
    loops = [f"{metric}{suffix}" for metric in BY_SHARE for suffix in ("", UNLOADING)]
    for metric, by_share in (*dict.fromkeys(CURVES, False).items(), *dict.fromkeys(loops, True).items()):
        grid, unit = SHARE_GRID if by_share else FORCE_GRID, (NUMBERS | BY_SHARE)[metric.removesuffix(UNLOADING)].units
        for condition in conditions:
            group = [
                (entry.participant, trial.curves.get(metric, [np.nan] * len(grid)))
                for entry, trial in stored
                if entry.condition == condition and trial is not None and trial.status == MEASURED
            ]
            curves = pd.DataFrame([curve for _, curve in group], index=[name for name, _ in group], dtype=np.float64)
            counts, means = curves.count(), curves.groupby(level=0).mean()
            people, mean_of_means = means.count(), means.mean()
            error = means.sem()
            reach = stats.t.ppf((1 + _LEVEL) / 2, people - 1) * error
            for column in np.flatnonzero(counts / len(group) >= _MOST_MISSING):
                mean, trials, x = float(mean_of_means[column]), int(counts[column]), float(grid[column])
                force, share = (np.nan, x) if by_share else (x, np.nan)
                values = (metric, unit, condition, force, share, mean, float(error[column]), mean - reach[column],
                          mean + reach[column], int(people[column]), trials, len(group) - trials)  # fmt: skip
                rows.append(dict(zip(_CURVE_COLUMNS, values, strict=True)))
    return rows


def _parse_number(text: str) -> float:
    """Parse a text as a number; return infinity if it is not one."""
    try:
        return float(text)
    except ValueError:
        return np.inf
