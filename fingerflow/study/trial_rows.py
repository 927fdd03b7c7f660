"""Reader of the rows in a CSV table of trials, as text."""

import csv
import re
from pathlib import Path

from fingerflow.errors import FingerflowError
from fingerflow.recordings.delimited import decimal_point, find_separator
from fingerflow.schema.text_file import read_text
from fingerflow.study.spreadsheet_cell import plain_cell

ANSWERS = {"1": True, "1.0": True, "true": True, "0": False, "0.0": False, "false": False}
NOTHING = ("", "nan", "na")  # contents of a cell without a value


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table, separated by commas, semicolons or tabs, as dictionaries from column name to text.

    Messages count rows from 1, the heading.

    Raises:
        FingerflowError: the file cannot be read, it has no rows, columns have no or the same names, or a row has more
            or fewer cells than the heading.
    """
    text = read_text(path, "give a CSV file in UTF-8").lstrip("#\n ")
    separator = find_separator(text.partition("\n")[0]) or ","
    try:
        reader = csv.reader(text.splitlines(keepends=True), delimiter=separator)
        heading, *rows = [row for row in reader if any(row)] or [[]]
    except csv.Error as error:
        raise FingerflowError(f"{path} cannot be read ({error}); give a CSV file in UTF-8") from error
    names = [name.strip() for name in heading]
    if not rows or "" in names or len(set(names)) < len(names):
        raise FingerflowError(
            f"{path}: has the columns {', '.join(map(repr, names)) or 'none'} and {len(rows)} rows; give a heading of "
            "different names and one row a trial"
        )
    for number, row in enumerate(rows, start=2):
        if len(row) != len(names):
            raise FingerflowError(
                f"{path}, row {number}: {len(row)} cells, the heading has {len(names)}; are separators missing?"
            )
    if separator != ",":  # such tables have decimal commas
        numbers = "\n".join(cell for row in rows for cell in row if re.fullmatch(r"\s*-?\d+([.,]\d+)+\s*", cell))
        try:
            decimal_point(numbers, separator)
        except ValueError as error:
            raise FingerflowError(f"{path}: {error}") from None
        rows = [[re.sub(r"^(\s*-?\d+),(\d+\s*)$", r"\1.\2", cell) for cell in row] for row in rows]
    return [{name: plain_cell(cell.strip()) for name, cell in zip(names, row, strict=True)} for row in rows]
