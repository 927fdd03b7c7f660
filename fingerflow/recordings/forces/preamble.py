"""Removal of preambles before the table in a text file, such as the header of a LabVIEW measurement file."""

import re
from itertools import islice
from pathlib import Path

from fingerflow.errors import FingerflowError
from fingerflow.recordings.delimited import find_separator, is_numeric, is_read, split_cells

_END_OF_HEADER = "***End_of_Header***"
_LOOKED_AT = 400  # number of lines within which the table must begin
_RUN = 3  # consecutive lines of numbers that identify a table


def without_preamble(path: Path, text: str) -> tuple[str, float | None, float]:
    """Return the table in a text, from its heading on, without the lines above (preamble), with the sample rate (Hz) or
    None and the start time (s) that they state; a table is recognised by consecutive lines with equally many numbers.

    A LabVIEW measurement file (`.lvm`) has two headers that end in ***End_of_Header***, of the file and of its segment.
    Its column X_Value is the time, or its Delta_X the step if that column was not written. In other files the text
    before the heading is skipped. The heading is the line above the numbers with as many cells, or the line above that
    if a line of units stands between.

    Raises FingerflowError for a LabVIEW file of several segments.
    """
    if _END_OF_HEADER in text:
        return _read_labview(path, text)
    lines, cells, widths = [], [], []
    for line in islice(re.finditer(r"[^\r\n]+", text), _LOOKED_AT):
        if is_read(line.group()):
            row = split_cells(line.group(), find_separator(line.group()))
            lines.append(line)
            cells.append(row)
            widths.append(len(row) if is_numeric(row) else 0)
            if len(widths) >= _RUN and {*widths[-_RUN:]} == {widths[-1]} - {0}:
                break
    else:
        return text, None, 0.0
    first = len(widths) - _RUN
    if first < 2:
        return text, None, 0.0
    above, higher = cells[first - 1], cells[first - 2]
    both = len(higher) == widths[first]
    if len(above) != widths[first] or (both and first == 2):  # ambiguous, or only names and units without a preamble
        return text, None, 0.0
    is_units = both and all(len(cell) <= 4 or cell[:1] in "([" for cell in above)
    return text[lines[first - 1 - is_units].start() :], None, 0.0


def _read_labview(path: Path, text: str) -> tuple[str, float | None, float]:
    *headers, body = text.split(_END_OF_HEADER)
    if len(headers) > 2:
        raise FingerflowError(
            f"{path}: is a LabVIEW file of {len(headers) - 1} segments, which are recordings of their own; write one "
            "a file (in Write To Measurement File: one header only)"
        )
    stated = {}
    for line in "".join(headers).splitlines():
        key, *values = re.split(r"[\t,;]", line.strip()) if "\t" not in line else line.strip().split("\t")
        stated[key.strip()] = [value.strip() for value in values if value.strip()]

    def number(key: str) -> float | None:
        try:
            return float(stated[key][0].replace(",", "."))
        except (KeyError, IndexError, ValueError):
            return None

    body = body.partition("\n")[2].lstrip("\r\n")
    body = re.sub(r"[\t,;]Comment[ \t]*(?=\r?\n)", "", body, count=1)
    for key in ("X0", "Delta_X"):
        if len(set(stated.get(key, ()))) > 1:
            raise FingerflowError(
                f"{path}: its channels run on different clocks ({key} is {', '.join(stated[key])}); write those that "
                "belong together to one file"
            )
    step, start = number("Delta_X"), number("X0") or 0.0
    columns = stated.get("X_Columns", ["One"])[0]
    if columns == "Multi":
        raise FingerflowError(f"{path}: each channel has its own times (X_Columns Multi); write one X column")
    if columns == "No":
        body = re.sub(r"^(?:X_Value)?[\t,;]", "", body, flags=re.MULTILINE)
        return body, None if not step else 1 / step, start
    return re.sub(r"^X_Value", "time", body, count=1), None, 0.0
