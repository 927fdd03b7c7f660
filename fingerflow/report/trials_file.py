"""Reader of a table of trials from a CSV file: one row a trial, column names in the heading."""

import csv
import math
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.models.observer import Trials, read_trials

_NAMES = ("participant", "trial")  # kept as text; conditions are numbers if all of them are
_ANSWERS = {"1": True, "true": True, "0": False, "false": False}
_NOTHING = ("", "nan", "na")


def load_trials(path: str | PathLike[str]) -> Trials:
    """Read a CSV table of trials, and check it by `fingerflow.models.observer.read_trials`.

    Columns `participant`, `trial`, `condition` (the vibration amplitude in µm, for figures against it), `answer` (1 or
    true where the comparison was felt as more slippery, which is correct) and metrics. An empty cell is NaN.

    Raises:
        FingerflowError: the file cannot be read, a row has more or fewer cells than the heading, an answer or a metric
            is invalid, or as in `read_trials`.
    """
    location = Path(path)
    try:
        with location.open(encoding="utf-8-sig", newline="") as file:
            heading, *rows = [row for row in csv.reader(file) if row] or [[]]
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FingerflowError(f"{location} cannot be read ({reason}); give a CSV file of trials") from error
    names = [name.strip() for name in heading]
    if len(set(names)) < len(names) or not rows:
        raise FingerflowError(
            f"{location}: has the columns {', '.join(names) or 'none'} and {len(rows)} rows; give a heading of "
            "different names and one row a trial"
        )
    for number, row in enumerate(rows):
        if len(row) != len(names):
            raise FingerflowError(
                f"{location}: trial {number + 1} has {len(row)} cells, the heading {len(names)}; are commas missing?"
            )
    columns = {name: _typed(location, name, [row[place].strip() for row in rows]) for place, name in enumerate(names)}
    try:
        return read_trials(columns)
    except FingerflowError as error:
        raise FingerflowError(f"{location}: {error}") from None


def _typed(path: Path, name: str, cells: list[str]) -> NDArray[Any]:
    if name in _NAMES:
        return np.array(cells)
    if name == "answer":
        for number, cell in enumerate(cells):
            if cell.lower() not in _ANSWERS:
                raise FingerflowError(
                    f"{path}: the answer of trial {number + 1} is {cell!r}; give 1 where it was correct, 0 where not"
                )
        return np.array([_ANSWERS[cell.lower()] for cell in cells])
    numbers = []
    for number, cell in enumerate(cells):
        try:
            numbers.append(math.nan if cell.lower() in _NOTHING else float(cell))
        except ValueError:
            if name == "condition":
                return np.array(cells)
            raise FingerflowError(
                f"{path}: {name} of trial {number + 1} is {cell!r}; give a number, or nothing where there is none"
            ) from None
    return np.array(numbers)
