"""Reader of the rows in a CSV table of trials, as text."""

import csv
from pathlib import Path

from fingerflow.errors import FingerflowError
from fingerflow.schema.spreadsheet_cell import plain_cell

ANSWERS = {"1": True, "true": True, "0": False, "false": False}
NOTHING = ("", "nan", "na")  # contents of a cell without a value


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file as dictionaries from column name to text.

    Messages count rows from 1, the heading.

    Raises:
        FingerflowError: the file cannot be read, it has no rows, columns have no or the same names, or a row has more
            or fewer cells than the heading.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            heading, *rows = [row for row in csv.reader(file) if row] or [[]]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise FingerflowError(f"{path} cannot be read ({reason}); give a CSV file in UTF-8") from error
    names = [name.strip() for name in heading]
    if not rows or "" in names or len(set(names)) < len(names):
        raise FingerflowError(
            f"{path}: has the columns {', '.join(map(repr, names)) or 'none'} and {len(rows)} rows; give a heading of "
            "different names and one row a trial"
        )
    for number, row in enumerate(rows, start=2):
        if len(row) != len(names):
            raise FingerflowError(
                f"{path}, row {number}: {len(row)} cells, the heading has {len(names)}; are commas missing?"
            )
    return [{name: plain_cell(cell.strip()) for name, cell in zip(names, row, strict=True)} for row in rows]
