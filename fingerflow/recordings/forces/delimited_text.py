"""Reader of forces in delimited text files (CSV and similar), with units in the heading."""

import io
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError, first_line
from fingerflow.recordings.delimited import decimal_point, find_separator, is_numeric, is_read, split_cells
from fingerflow.recordings.forces.force_table import ForceTable, split_unit
from fingerflow.recordings.forces.preamble import without_preamble
from fingerflow.schema.text_file import read_text

_MOST_BYTES = 1 << 30


def read_table(path: Path) -> ForceTable:
    """Return all columns of a delimited text file with forces.

    The heading is the first line that is neither a comment nor part of the preamble, or the comment just above the
    numbers if it has as many cells; a line of units may follow. Its separator is a semicolon, else a tab, else a comma,
    else a bar, else blanks; a comma that does not separate is a decimal comma. Cells may be quoted. Without a heading
    the columns are column_1, column_2, ...

    Raises FingerflowError for numbers that may have thousands marks, and for anything besides numbers, with the line.
    """
    text = read_text(path, "export the forces again", _MOST_BYTES, "latin-1")
    table = ForceTable(path, {})
    text, table.sample_rate, table.start = without_preamble(path, text)
    lines = (line for line in re.finditer(r"[^\n]+", text) if is_read(line.group()))
    first = next(lines, None)
    if first is None:
        raise FingerflowError(f"{path}: has no line besides comments")
    separator, split = _split(first.group())
    sample: re.Match[str] | None = first
    if is_numeric(split):
        above = _split(text[: first.start()].rstrip().rpartition("\n")[2].lstrip("#%/ "))[1]
        names = [f"column_{number + 1}" for number in range(len(split))]
        if len(above) == len(split) and not any(is_numeric([cell]) for cell in above):
            names, table.units, _ = _heading(path, above, "", separator)
    else:
        sample = next(lines, None)
        names, table.units, has_units = _heading(path, split, "" if sample is None else sample.group(), separator)
        sample = next(lines, None) if has_units else sample
    if sample is None:
        raise FingerflowError(f"{path}: has a heading {split} but no sample")
    body = text[sample.start() :]
    if not body.endswith("\n") and len(body.splitlines()) > 1:
        # Some programs do not end their last line; but the file may also have been cut off within it.
        *complete, last = body.splitlines()
        whole = len(split_cells(last, separator)) == len(names)
        body = body if whole else "\n".join(complete)
        state = f"the line is {'read' if whole else 'incomplete and left out'}. Copy the file again if it was longer"
        table.warnings.append(f"{path}: the last line has no line break, so its last number may be cut off: {state}")
    if re.search(r"^\s*(?:[#%]|//)", body, re.MULTILINE):
        body = "\n".join(filter(is_read, body.splitlines()))
    stated = separator
    if '"' in body:
        body, separator = "\n".join("\t".join(split_cells(line, separator)) for line in body.splitlines()), "\t"
    try:
        body = body if separator == "," else decimal_point(body, stated)
    except ValueError as error:
        raise FingerflowError(f"{path}: {error}") from None
    try:
        numbers = _numbers(body, separator, len(names))
    except ValueError as error:
        raise FingerflowError(f"{path}: {_fault(body, separator, names) or first_line(error)}") from None
    table.columns = dict(zip(names, map(np.ascontiguousarray, numbers.T), strict=True))
    return table


def _split(line: str) -> tuple[str | None, list[str]]:
    """Return the separator of a line and its cells; a blank before a unit does not separate."""
    separator = find_separator(line)
    return separator, split_cells(line if separator else re.sub(r"\s+([(\[])", r"\1", line), separator)


def _numbers(body: str, separator: str | None, columns: int) -> NDArray[np.float64]:
    """Return the numbers (lines, columns) of a table, given the text below its heading; raise ValueError unless every
    line has `columns` numbers.
    """
    mark = re.escape(separator or "")
    if mark and re.search(rf"{mark}\s*$", body.partition("\n")[0]):
        body = re.sub(rf"(?:{mark})+[ ]*$", "", body, flags=re.MULTILINE)
    numbers = np.loadtxt(io.StringIO(body), delimiter=separator, ndmin=2, comments=None)
    if numbers.shape[1] != columns:
        raise ValueError(f"{numbers.shape[1]} cells a line")
    return numbers


def _fault(body: str, separator: str | None, names: list[str]) -> str:
    """Return what in the table is no number, with the line, as the end of a sentence; "" if every cell is a number."""
    for line in filter(is_read, body.splitlines()):
        cells = [cell.strip() for cell in line.split(separator)]
        if len(cells) > len(names) and separator == "," and is_numeric(cells):
            return (
                f"{line.strip()!r} has {len(cells)} cells below {len(names)} names {names}. If the comma is a decimal "
                "one, or a thousands mark, separate the columns by semicolons or tabs; else name every column"
            )
        wrong = next((pair for pair in zip(names, cells, strict=False) if not is_numeric(pair[1:])), None)
        if len(cells) < len(names) or any(cells[len(names) :]):
            return f"{line.strip()!r} has {len(cells)} cells, the heading {len(names)}; remove what is no sample"
        if wrong is not None:
            name, cell = wrong
            if re.match(r"\d+[:/-]\d", cell):
                remedy = "export the time in seconds, or leave the column out and give the sample_rate"
                return f"column {name!r} has {cell!r}, a date or time of day; {remedy}"
            if re.fullmatch(r"[-+.\d]+[dD][-+]?\d+", cell):
                return f"column {name!r} has {cell!r}, a number of Fortran; write its exponent with E"
            shown, remedy = f"{cell!r}, no number," if cell else "empty", "leave the column or the line out"
            return f"column {name!r} is {shown} in {line.strip()!r}; write nan there, or {remedy}"
    return ""


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
