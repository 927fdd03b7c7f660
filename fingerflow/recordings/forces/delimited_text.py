"""Reader of forces in delimited text files (CSV and similar), with units in the heading."""

import io
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError, first_line
from fingerflow.recordings.forces.force_table import ForceTable, split_unit
from fingerflow.recordings.forces.preamble import find_separator, is_numeric, is_read, split_cells, without_preamble


def read_table(path: Path) -> ForceTable:
    """Return all columns of a delimited text file with forces.

    The heading is the first line that is neither a comment nor part of the preamble; a line of units may follow. Its
    separator is a semicolon, else a tab, else a comma, else blanks; a comma that does not separate is a decimal comma.
    Without a heading the columns are column_1, column_2, ...
    """
    data = path.read_bytes()
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    table = ForceTable(path, {})
    text, table.sample_rate, table.start = without_preamble(path, text)
    lines = (line for line in re.finditer(r"[^\r\n]+", text) if is_read(line.group()))
    first = next(lines, None)
    if first is None:
        raise FingerflowError(f"{path}: has no line besides comments")
    heading = first.group()
    separator = find_separator(heading)
    if separator is None:
        heading = re.sub(r"\s+([(\[])", r"\1", heading)  # removes the blank before a unit, which is not a separator
    split = split_cells(heading, separator)
    sample: re.Match[str] | None = first
    if is_numeric(split):
        names = [f"column_{number + 1}" for number in range(len(split))]
    else:
        sample = next(lines, None)
        names, table.units, has_units = _heading(path, split, "" if sample is None else sample.group(), separator)
        sample = next(lines, None) if has_units else sample
    if sample is None:
        raise FingerflowError(f"{path}: has a heading {split} but no sample")
    body = text[sample.start() :]
    if not body.endswith(("\n", "\r")) and len(body.splitlines()) > 1:
        # Some programs do not end their last line; but the file may also have been cut off within it.
        *complete, last = body.splitlines()
        whole = len(split_cells(last, separator)) == len(names)
        body = body if whole else "\n".join(complete)
        table.warnings.append(
            f"{path}: the last line has no line break, so its last number may be cut off: the line is "
            f"{'read' if whole else 'incomplete and left out'}. Copy the file again if it was longer"
        )
    if separator != ",":
        body = body.replace(",", ".")
    try:
        numbers = _numbers(body, separator, len(names))
    except ValueError:
        # Remove comments among the samples. Filtering lines takes as long as reading, so it is done only if reading
        # fails.
        try:
            numbers = _numbers("\n".join(filter(is_read, body.splitlines())), separator, len(names))
        except ValueError as error:
            cells = sample.group().rstrip(", ;\t").count(separator or " ") + 1
            if separator == "," and cells > len(names):
                raise FingerflowError(
                    f"{path}: {sample.group().strip()!r} has {cells} cells below {len(names)} names {names}. If the "
                    "comma is a decimal one, separate the columns by semicolons or tabs; else name every column"
                ) from None
            raise FingerflowError(
                f"{path}: below the heading {split} there is something besides numbers ({first_line(error)}); leave "
                "numbers and comments only"
            ) from None
    for name, column in zip(names, numbers.T, strict=True):
        table.columns[name] = np.ascontiguousarray(column)
    return table


def _numbers(body: str, separator: str | None, columns: int) -> NDArray[np.float64]:
    """Return the numbers (lines, columns) of a table, given the text below its heading; raise ValueError unless every
    line has `columns` numbers.
    """
    if separator is not None and re.search(rf"{separator}\s*$", body.partition("\n")[0]):
        body = re.sub(rf"{separator}+[ \r]*$", "", body, flags=re.MULTILINE)
    numbers = np.loadtxt(io.StringIO(body), delimiter=separator, ndmin=2, comments=None)
    if numbers.shape[1] != columns:
        raise ValueError(f"{numbers.shape[1]} cells a line")
    return numbers


def _heading(path: Path, cells: list[str], below: str, separator: str | None) -> tuple[list[str], dict[str, str], bool]:
    """Return the names and units of all columns from the `cells` of a heading, and whether `below`, the line after it,
    is a separate line of units.
    """
    names, units = [], {}
    for cell in cells:
        name, unit = split_unit(cell)
        if not name or name in names:
            raise FingerflowError(f"{path}: column {name!r} appears twice or has no name in the heading {cells}")
        names.append(name)
        if unit:
            units[name] = unit
    second = [cell.strip("()[] ") for cell in split_cells(below, separator)][: len(names)]
    has_units = bool(below) and not any(is_numeric([cell]) for cell in second)
    if has_units:
        units.update({name: unit for name, unit in zip(names, second, strict=False) if unit})
    return names, units, has_units
