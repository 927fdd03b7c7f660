"""`python -m tests.silent GROUP`: run the cases of a group and print their table."""

import sys
from importlib import import_module

from tests.silent.case import Case


def main() -> None:
    """Run the group named on the command line."""
    if len(sys.argv) != 2:
        raise SystemExit("python -m tests.silent GROUP, the name of a module of tests/silent with a function cases()")
    rows = [Case._fields, *import_module(f"tests.silent.{sys.argv[1]}").cases()]
    widths = [max(len(row[column]) for row in rows) for column in range(len(Case._fields))]
    for row in rows:
        print("  ".join(value.ljust(width) for value, width in zip(row, widths, strict=True)).rstrip())


if __name__ == "__main__":
    main()
