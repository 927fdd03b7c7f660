"""`python -m bench`: run suites, print their tables, write one JSON file and the figures; `papers` reproduces both."""

import argparse
import importlib
import os
import pkgutil
import sys
import time
from pathlib import Path
from typing import Any

from bench import suites
from bench.environment import share_cores
from bench.record import write_record
from bench.rows import Skipped, as_table
from fingerflow.schema.variable_record import IN_PERCENT

FIGURES = Path(__file__).parent / "figures"


def main(arguments: list[str] | None = None) -> None:
    """Run the suites that the command line names, or reproduce the papers."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments[:1] == ["papers"]:
        os.environ.pop(IN_PERCENT, None)  # before the rows are imported: the papers print divergence as a ratio
        importlib.import_module("bench.papers.command").main(arguments[1:])
        return
    known = [module.name for module in pkgutil.iter_modules(suites.__path__)]
    parser = argparse.ArgumentParser(
        "python -m bench",
        description="Speed against error, beside the peers.",
        epilog="Both papers: python -m bench papers --help",
    )
    parser.add_argument("suite", nargs="*", help=f"one or more of: {', '.join(known)}; default all")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write machine, versions and all rows to FILE")
    parser.add_argument("--quick", action="store_true", help="small problems, few repetitions, no figure")
    parser.add_argument("--remark", default="", help="kept in the JSON file, such as what else the machine was doing")
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.suite) - set(known))
    if unknown:
        parser.error(f"no suite {', '.join(unknown)}; there are {', '.join(known)}")

    share_cores()
    measured = {name: _run(name, options.quick) for name in options.suite or known}
    if options.json is not None:
        write_record(options.json, measured, options.remark, options.quick)


def _run(name: str, quick: bool) -> dict[str, Any]:
    suite = importlib.import_module(f"{suites.__name__}.{name}")
    print(f"\n## {name}\n{suite.__doc__}")
    start = time.perf_counter()
    try:
        rows = suite.run(quick)
    except Skipped as reason:
        print(f"skipped: {reason}")
        return {"skipped": str(reason)}
    print(as_table(rows), flush=True)
    if hasattr(suite, "draw") and not quick:
        FIGURES.mkdir(exist_ok=True)
        suite.draw(rows, FIGURES / f"{name}.png")
    return {"about": suite.__doc__, "seconds": round(time.perf_counter() - start, 1), "rows": rows}


if __name__ == "__main__":
    main()
