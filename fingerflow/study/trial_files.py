"""Files of a trial in a study: a folder with its result and `row.json`, written atomically."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from pydantic import TypeAdapter

from fingerflow.errors import FingerflowError
from fingerflow.recordings.digest import digest_of
from fingerflow.results.atomic_write import write_text
from fingerflow.study.cache_keys import InputFile, Keys, describe_file

# Key of the digest of the rest of `row.json`, so that a number corrupted on disk does not get into the table.
_DIGEST = "digest"
MEASURED, FAILED = "measured", "failed"
Part = Literal["everything", "changed", "row"]


@dataclass(frozen=True)
class TrialRow:
    """Stored outcome of a trial (file `row.json`): status, cache keys, numbers and curves.

    Attributes:
        status: "measured" or "failed".
        reason: why there is no result, empty if there is one.
        passing: True if the reason is transient: disk, memory or the machine, not the trial.
        keys: of its inputs, settings and code; None if they could not be determined.
        result: name of the result's file in the same folder.
        content: size, time and digest of that file as written.
        row, curves: of `fingerflow.study.row.measure`.
        made: when, where, by which versions, in what time.
    """

    status: str
    reason: str = ""
    passing: bool = False
    keys: Keys | None = None
    result: str | None = None
    content: InputFile | None = None
    row: Mapping[str, Any] = field(default_factory=dict)
    curves: Mapping[str, list[float | None]] = field(default_factory=dict)
    made: Mapping[str, Any] = field(default_factory=dict)


_STORED = TypeAdapter(TrialRow)


def has_result(folder: Path, trial: TrialRow) -> bool:
    """Return True if the result file that a trial's `row.json` names is in its folder and was not modified since it was
    written.
    """
    if trial.result is None or trial.content is None:
        return False
    try:
        now = describe_file(folder / trial.result, trial.content)
    except FingerflowError:
        return False
    return (now.size, now.digest) == (trial.content.size, trial.content.digest)


def write_row(folder: Path, trial: TrialRow) -> None:
    """Write `row.json` of a trial, and delete result files other than the one it names."""
    content = json.loads(json.dumps(asdict(trial), allow_nan=False))
    text = json.dumps(content | {_DIGEST: digest_of(content)}, indent=1, ensure_ascii=False)
    write_text(folder / "row.json", text)
    for file in folder.glob("result-*.h5"):
        if file.name != trial.result:
            file.unlink(missing_ok=True)


def read_row(folder: Path) -> TrialRow | None:
    """Return the row stored in a trial's folder; None if it is missing or damaged, so that the trial is run again."""
    try:
        stored = json.loads((folder / "row.json").read_text(encoding="utf-8"))
        if stored.pop(_DIGEST) != digest_of(stored):
            return None
        return _STORED.validate_python(stored)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
