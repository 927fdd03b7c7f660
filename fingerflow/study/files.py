"""What a study keeps of a trial: a folder with its result and `row.json`, which appear whole or not at all."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from fingerflow.errors import FingerflowError
from fingerflow.recordings.digest import digest_of
from fingerflow.results.atomic_write import write_atomically
from fingerflow.study.keys import InputFile, Keys, look_at

_DIGEST = "digest"  # of all else in `row.json`: a number that changed on the disk must not get into the table
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
        content: that file, as it was written.
        row, curves: of `fingerflow.study.row.measure`.
        made: when, where, by what versions, in which time.
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


def result_name(keys: Keys) -> str:
    """By what it is made of: two runs with other settings never write the same file."""
    return f"result-{keys.result}.h5"


def has_result(folder: Path, trial: TrialRow) -> bool:
    """Whether the result that a row speaks of is there, as it was written."""
    if trial.result is None or trial.content is None:
        return False
    try:
        now = look_at(folder / trial.result, trial.content)
    except FingerflowError:
        return False
    return (now.size, now.digest) == (trial.content.size, trial.content.digest)


def write_row(folder: Path, trial: TrialRow) -> None:
    """Writes `row.json`, and removes results that it does not speak of."""
    content = asdict(trial) | {"keys": trial.keys and trial.keys.as_json()}
    content = json.loads(json.dumps(content, allow_nan=False))
    text = json.dumps(content | {_DIGEST: digest_of(content)}, indent=1, ensure_ascii=False)
    write_atomically(folder / "row.json", lambda part: part.write_text(text, encoding="utf-8"))
    for other in folder.glob("result-*.h5"):
        if other.name != trial.result:
            other.unlink(missing_ok=True)


def read_row(folder: Path) -> TrialRow | None:
    """None where nothing is known, as where `row.json` is not what was written: then the trial is run again."""
    try:
        found = json.loads((folder / "row.json").read_text(encoding="utf-8"))
        if found.pop(_DIGEST) != digest_of(found):
            return None
        keys = None if found["keys"] is None else Keys.from_json(found["keys"])
        content = None if found["content"] is None else InputFile(**found["content"])
        return TrialRow(**{**found, "keys": keys, "content": content})
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
