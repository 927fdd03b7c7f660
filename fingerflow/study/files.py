"""What a study keeps of a trial: a folder with its result and `row.json`, which appear whole or not at all."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from fingerflow.atomic_write import write_atomically
from fingerflow.study.keys import Keys

MEASURED, FAILED = "measured", "failed"
Part = Literal["everything", "changed", "row"]


@dataclass(frozen=True)
class TrialRow:
    """What is known of a trial that was run.

    Attributes:
        status: "measured" or "failed".
        reason: why there is no result, empty where there is one.
        passing: whether the reason lies in disk, memory or the machine, and not in the trial.
        keys: what it was made of; None where that could not be found out.
        result: name of the file of the result in the same folder.
        row, curves: of `fingerflow.study.row.measure`.
        made: when, where, by what versions, in which time.
    """

    status: str
    reason: str = ""
    passing: bool = False
    keys: Keys | None = None
    result: str | None = None
    row: Mapping[str, Any] = field(default_factory=dict)
    curves: Mapping[str, list[float | None]] = field(default_factory=dict)
    made: Mapping[str, Any] = field(default_factory=dict)


def result_name(keys: Keys) -> str:
    """By what it is made of: two runs with other settings never write the same file."""
    return f"result-{keys.result}.h5"


def write_row(folder: Path, trial: TrialRow) -> None:
    """Writes `row.json`, and removes results that it does not speak of."""
    content = asdict(trial) | {"keys": trial.keys and trial.keys.as_json()}
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
    write_atomically(folder / "row.json", lambda part: part.write_text(text, encoding="utf-8"))
    for other in folder.glob("result-*.h5"):
        if other.name != trial.result:
            other.unlink(missing_ok=True)


def read_row(folder: Path) -> TrialRow | None:
    """None where nothing is known, as where `row.json` is damaged: then the trial is run again."""
    try:
        found = json.loads((folder / "row.json").read_text(encoding="utf-8"))
        keys = None if found["keys"] is None else Keys.from_json(found["keys"])
        return TrialRow(**{**found, "keys": keys})
    except (OSError, ValueError, KeyError, TypeError):
        return None
