"""Forces in delimited text: comma, semicolon, tab or blanks; decimal point or comma; comments; units in the heading."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np

from fingerflow.errors import FingerflowError
from fingerflow.recordings.forces.table import Table, split_unit

COMMENTS = ("#", "%", "//")


def read_table(path: Path) -> Table:
    """Read all columns. The heading is the first line that is no comment; a line of units may follow it.

    A semicolon in the heading separates columns before a tab, a tab before a comma, a comma before blanks; a comma that
    does not separate is a decimal comma. Without a heading the columns are column_1, column_2, ...
    """
    data = path.read_bytes()
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    lines = [line for line in text.splitlines() if (begun := line.lstrip()) and not begun.startswith(COMMENTS)]
    if not lines:
        raise FingerflowError(f"{path}: has no line besides comments")
    separator = next((mark for mark in (";", "\t", ",") if mark in lines[0]), None)
    if separator is None:
        lines[0] = re.sub(r"\s+([(\[])", r"\1", lines[0])  # the blank before a unit separates no columns
    split = [cell.strip().strip('"').strip() for cell in lines[0].split(separator)]
    units: dict[str, str] = {}
    if _is_numeric(split, separator):
        names, rows = [f"column_{number + 1}" for number in range(len(split))], lines
    else:
        names, units, rows = _heading(path, split, lines[1:], separator)
    if not rows:
        raise FingerflowError(f"{path}: has a heading {split} but no sample")
    body = "\n".join(rows)
    if separator != ",":
        body = body.replace(",", ".")
    try:
        numbers = np.loadtxt(io.StringIO(body), delimiter=separator, ndmin=2, comments=None, usecols=range(len(names)))
    except ValueError as error:
        raise FingerflowError(
            f"{path}: below the heading {split} there is something besides numbers: {error}"
        ) from None
    table = Table(path, {}, units)
    for name, column in zip(names, numbers.T, strict=True):
        table.columns[name] = np.ascontiguousarray(column)
    return table


def _heading(
    path: Path, cells: list[str], rows: list[str], separator: str | None
) -> tuple[list[str], dict[str, str], list[str]]:
    while cells and not cells[-1]:
        cells.pop()  # a separator at the end of each line
    names, units = [], {}
    for cell in cells:
        name, unit = split_unit(cell)
        if not name or name in names:
            raise FingerflowError(f"{path}: column {name!r} appears twice or has no name in the heading {cells}")
        names.append(name)
        if unit:
            units[name] = unit
    if rows:
        second = [cell.strip().strip('"').strip("()[] ") for cell in rows[0].split(separator)][: len(names)]
        if not any(_is_numeric([cell], separator) for cell in second):
            units.update({name: unit for name, unit in zip(names, second, strict=False) if unit})
            rows = rows[1:]
    return names, units, rows


def _is_numeric(cells: list[str], separator: str | None) -> bool:
    try:
        for cell in cells:
            if cell:
                float(cell if separator == "," else cell.replace(",", "."))
    except ValueError:
        return False
    return any(cells)
