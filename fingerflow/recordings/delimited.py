"""Lines of delimited text: separator, cells, numbers and the decimal mark of a table."""

import csv
import re
from collections.abc import Sequence

# Cells of these letters only are numbers, with a decimal point or comma.
_NUMBER = r"[-+]?\d[\d.,]*(?:[eE][-+]?\d+)?"


def is_read(line: str) -> bool:
    """Return whether a line of text is a heading or data, that is, neither blank nor a comment."""
    begun = line.lstrip()
    return bool(begun) and not begun.startswith(("#", "%", "//"))


def find_separator(line: str) -> str | None:
    """Return the separator between the cells of a line: semicolon, tab, comma or bar; None if blanks separate."""
    line = re.sub(r'"[^"]*"', '""', line)
    if re.fullmatch(r"\s*[-+\d.eE]+(?:,\d+(?:[eE][-+]?\d+)?)?(?:\s+[-+\d.eE]+(?:,\d+(?:[eE][-+]?\d+)?)?)+\s*", line):
        return "\t" if "\t" in line else None
    return next((mark for mark in ";\t,|" if mark in line), None)


def split_cells(line: str, separator: str | None) -> list[str]:
    """Return the cells of a line, stripped of blanks and quotes; empty cells at the end of the line are dropped."""
    cells = next(csv.reader([line], delimiter=separator or " ")) if ('"' in line) else line.split(separator)
    cells = [cell.strip().strip('"').strip() for cell in cells]
    while cells and not cells[-1]:
        cells.pop()
    return cells


def is_numeric(cells: Sequence[str]) -> bool:
    """Return whether all non-empty cells of a line are numbers; False if all cells are empty."""
    try:
        for cell in filter(None, cells):
            float(cell.replace(",", ".") if cell.isascii() and "_" not in cell else "none")
    except ValueError:
        return False
    return any(cells)


def decimal_point(text: str, separator: str | None) -> str:
    """Return the numbers of a table, whose cells no comma separates, with a decimal point in place of a comma.

    separator: of the cells in the file. A point is a decimal one in tables that commas or blanks separate; otherwise
    both marks may be that of thousands, and 1.234 is 1234 in some countries.

    Raises ValueError, whose message names a cell, if the table has both marks, or one that may be either: each number
    with it has three digits behind it and one to three, without a leading zero, before it.
    """
    marks = [mark for mark in ".," if mark in text]
    cell = re.search(_NUMBER.replace(r"\d[", r"\d*[.,]["), text)
    advice = "write numbers without thousands marks"
    if len(marks) == 2 and cell is not None:
        other = re.search(rf"[^\s;]*[{',' if '.' in cell[0] else '.'}][^\s;]*", text)
        beside = f"{cell[0]!r} beside {'' if other is None else other[0]!r}"
        wrong = "one of them is a thousands mark, or columns differ in their decimal mark"
        raise ValueError(f"points and commas in one table, {beside}: {wrong}; {advice} and with one decimal mark")
    for mark in marks:
        sure = rf"(?<![\d.,])0+[{mark}]|(?<!\d)[{mark}]|\d{{4}}[{mark}]|[{mark}](?!\d{{3}}(?![\deE]))"
        if cell is not None and (mark == "," or separator in (";", "\t", "|")) and not re.search(sure, text):
            raise ValueError(
                f"the number {cell[0]!r} may be decimal or have a thousands mark; {advice}, or more decimals"
            )
    return text.replace(",", ".")
