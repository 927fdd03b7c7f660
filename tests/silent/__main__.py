"""`python -m tests.silent GROUP`: run the cases of a group, print their table, and write it to bench/results.

The documentation makes its tables of these files, so that a new run and a build of the site are all that a changed
number needs.
"""

import sys
import time
from importlib import import_module
from pathlib import Path

from bench.record import RESULTS, write_record
from tests.silent.case import Case


def main() -> None:
    """Run the group named on the command line."""
    groups = [file.stem for file in sorted(Path(__file__).parent.glob("*.py")) if "\ndef cases(" in file.read_text()]
    if len(sys.argv) != 2 or sys.argv[1] not in groups:
        raise SystemExit(f"python -m tests.silent GROUP, one of {', '.join(groups)}")
    group, start = sys.argv[1], time.perf_counter()
    module = import_module(f"tests.silent.{group}")
    found = list(module.cases())
    rows = [Case._fields, *found]
    widths = [max(len(row[column]) for row in rows) for column in range(len(Case._fields))]
    for row in rows:
        print("  ".join(value.ljust(width) for value, width in zip(row, widths, strict=True)).rstrip())
    if found:
        seconds = round(time.perf_counter() - start, 1)
        suite = {"about": module.__doc__, "command": f"python -m tests.silent {group}", "seconds": seconds}
        write_record(RESULTS / f"silent-{group}.json", {group: suite | {"rows": [one._asdict() for one in found]}})


if __name__ == "__main__":
    main()
