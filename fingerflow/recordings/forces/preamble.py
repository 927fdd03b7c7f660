"""Preambles of text files before the table: headers of LabVIEW measurement files, notes of other programs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from fingerflow.errors import FingerflowError

_END_OF_HEADER = "***End_of_Header***"
_LOOKED_AT = 400  # lines in which the table must begin
_RUN = 3  # consecutive lines of numbers that identify a table


class Content(NamedTuple):
    """Table of a file: its text from the heading on; sample rate in Hz and start in s if the preamble states them."""

    text: str
    sample_rate: float | None = None
    start: float = 0.0


def without_preamble(path: Path, text: str) -> Content:
    """Return the table of a text: its consecutive lines of numbers, with the heading above them.

    A LabVIEW measurement file (`.lvm`) has two headers that end in ***End_of_Header***, of the file and of its segment.
    Its column X_Value is the time, or its Delta_X the step if that column was not written. In other files the text
    before the heading is skipped. The heading is the line above the numbers with as many cells, or the line above that
    if a line of units stands between.

    Raises FingerflowError for a LabVIEW file of several segments.
    """
    if _END_OF_HEADER in text:
        return _of_labview(path, text)
    lines = islice(re.finditer(r"[^\r\n]+", text), _LOOKED_AT)
    read: list[re.Match[str]] = []
    cells: list[list[str]] = []
    numbers: list[int] = []
    first = 0
    for line in lines:
        if not is_read(line.group()):
            continue
        read.append(line)
        cells.append(_cells(line.group()))
        numbers.append(_numbers(cells[-1]))
        if len(numbers) >= _RUN and numbers[-1] and numbers[-_RUN:] == [numbers[-1]] * _RUN:
            first = len(numbers) - _RUN
            break
    if first < 2:
        return Content(text)
    width = numbers[first]
    above, higher = cells[first - 1], cells[first - 2]
    names = [one for one in (above, higher) if len(_trimmed(one)) == width]
    names_and_units = first == 2 and len(names) == 2
    if names_and_units or not names or names[0] is not above:  # or ambiguous
        return Content(text)
    is_units = len(names) == 2 and all(len(cell) <= 4 or cell[:1] in "([" for cell in _trimmed(above))
    return Content(text[read[first - 1 - is_units].start() :])


def _of_labview(path: Path, text: str) -> Content:
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
    step, start = number("Delta_X"), number("X0") or 0.0
    if stated.get("X_Columns", ["One"])[0] == "No":
        body = re.sub(r"^(?:X_Value)?[\t,;]", "", body, flags=re.MULTILINE)
        return Content(body, None if not step else 1 / step, start)
    return Content(re.sub(r"^X_Value", "time", body, count=1))


def is_read(line: str) -> bool:
    """Return whether a line is neither blank nor a comment."""
    begun = line.lstrip()
    return bool(begun) and not begun.startswith(("#", "%", "//"))


def _cells(line: str) -> list[str]:
    separator = separator_of(line)
    return [cell.strip().strip('"').strip() for cell in line.split(separator)]


def separator_of(line: str) -> str | None:
    """Return the separator of the cells of a line; None for blanks, between which commas are decimal commas."""
    if re.fullmatch(r"\s*[-+\d.eE]+(?:,\d+(?:[eE][-+]?\d+)?)?(?:\s+[-+\d.eE]+(?:,\d+(?:[eE][-+]?\d+)?)?)+\s*", line):
        return "\t" if "\t" in line else None
    return next((mark for mark in (";", "\t", ",") if mark in line), None)


def _trimmed(cells: Sequence[str]) -> list[str]:
    """Return cells without empty ones at the end."""
    count = len(cells)
    while count and not cells[count - 1]:
        count -= 1
    return list(cells[:count])


def _numbers(cells: Sequence[str]) -> int:
    """Return the number of cells of a line of numbers, 0 for any other line."""
    try:
        for cell in _trimmed(cells):
            float(cell.replace(",", "."))
    except ValueError:
        return 0
    return len(_trimmed(cells))
