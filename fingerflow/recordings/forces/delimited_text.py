"""Forces in delimited text: comma, semicolon, tab or blanks; decimal point or comma; comments; units in the heading."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

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
    lines = (line for line in re.finditer(r"[^\r\n]+", text) if _is_read(line.group()))
    first = next(lines, None)
    if first is None:
        raise FingerflowError(f"{path}: has no line besides comments")
    heading = first.group()
    separator = next((mark for mark in (";", "\t", ",") if mark in heading), None)
    if separator is None:
        heading = re.sub(r"\s+([(\[])", r"\1", heading)  # the blank before a unit separates no columns
    split = [cell.strip().strip('"').strip() for cell in heading.split(separator)]
    units: dict[str, str] = {}
    sample: re.Match[str] | None = first
    if _is_numeric(split, separator):
        names = [f"column_{number + 1}" for number in range(len(split))]
    else:
        sample = next(lines, None)
        names, units, has_units = _heading(path, split, "" if sample is None else sample.group(), separator)
        sample = next(lines, None) if has_units else sample
    if sample is None:
        raise FingerflowError(f"{path}: has a heading {split} but no sample")
    body = text[sample.start() :]
    if separator != ",":
        body = body.replace(",", ".")
    try:
        numbers = _numbers(body, separator, len(names))
    except ValueError:
        # Among the samples there may be comments: looking at each line takes as long as reading the numbers.
        try:
            numbers = _numbers("\n".join(filter(_is_read, body.splitlines())), separator, len(names))
        except ValueError as error:
            raise FingerflowError(
                f"{path}: below the heading {split} there is something besides numbers: {error}"
            ) from None
    table = Table(path, {}, units)
    for name, column in zip(names, numbers.T, strict=True):
        table.columns[name] = np.ascontiguousarray(column)
    return table


def _is_read(line: str) -> bool:
    begun = line.lstrip()
    return bool(begun) and not begun.startswith(COMMENTS)


def _numbers(body: str, separator: str | None, columns: int) -> NDArray[np.float64]:
    return np.loadtxt(io.StringIO(body), delimiter=separator, ndmin=2, comments=None, usecols=range(columns))


def _heading(path: Path, cells: list[str], below: str, separator: str | None) -> tuple[list[str], dict[str, str], bool]:
    """Names and units of the columns, and whether the line below the heading holds units."""
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
    second = [cell.strip().strip('"').strip("()[] ") for cell in below.split(separator)][: len(names)]
    has_units = bool(below) and not any(_is_numeric([cell], separator) for cell in second)
    if has_units:
        units.update({name: unit for name, unit in zip(names, second, strict=False) if unit})
    return names, units, has_units


def _is_numeric(cells: list[str], separator: str | None) -> bool:
    try:
        for cell in cells:
            if cell:
                float(cell if separator == "," else cell.replace(",", "."))
    except ValueError:
        return False
    return any(cells)
