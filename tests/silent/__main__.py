"""Print the table of cases of a group: `python -m tests.silent GROUP`, of a module of this folder."""

import importlib
import sys

from tests.silent.case import Case


def main() -> None:
    rows = [Case._fields, *importlib.import_module(f"tests.silent.{sys.argv[1]}").cases()]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


if __name__ == "__main__":
    main()
