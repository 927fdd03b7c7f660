"""Records of benchmark runs as JSON files: date, machine, versions, threads and the rows of each suite."""

import json
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any, NamedTuple

from bench.environment import describe

RESULTS = Path(__file__).parent / "results"


def write_record(path: Path, suites: Mapping[str, Any], remark: str = "", quick: bool = False) -> None:
    """Write the record of a run, and replace the file if it is there.

    `suites` has for each suite `about`, its docstring, `seconds` and `rows`; or `skipped`, the reason. `command` is the
    command that repeats it, where this is not `python -m bench` with the suite's name.
    """
    record = {"date": date.today().isoformat(), "remark": remark, "quick": quick, **describe(), "suites": suites}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(record, indent=1, allow_nan=False) + "\n", encoding="utf-8")


class Recorded(NamedTuple):
    """Suite of a record: the file, and `about`, `seconds` and `rows` as `write_record` got them."""

    path: Path
    suite: Mapping[str, Any]


def newest_suites() -> dict[str, Recorded]:
    """Return for each suite with rows in bench/results the newest record of it."""
    records = [(path, json.loads(path.read_text(encoding="utf-8"))) for path in RESULTS.glob("*.json")]
    records.sort(key=lambda one: (one[1]["date"], one[0].name))
    return {
        name: Recorded(path, suite)
        for path, record in records
        for name, suite in record["suites"].items()
        if "rows" in suite
    }
