"""Reader of a table of trials from a CSV file with one row per trial and column names in the first line."""

import math
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.models.observer import Trials, read_trials
from fingerflow.schema.trial_rows import ANSWERS, NOTHING, read_rows

_NAMES = ("participant", "trial")  # columns that stay text; conditions are numbers if all of them are


def load_trials(path: str | PathLike[str]) -> Trials:
    """Read a table of trials from a CSV file and validate it with `fingerflow.models.observer.read_trials`.

    Columns `participant`, `trial`, `condition` (the vibration amplitude in µm, for figures against it), `answer` (1 or
    true where the comparison was felt as more slippery, which is correct) and metrics. An empty cell is NaN.

    Raises:
        FingerflowError: an answer or a metric is invalid, or as in `read_rows` and `read_trials`.
    """
    location = Path(path)
    rows = read_rows(location)
    columns = {name: _typed(location, name, [row[name] for row in rows]) for name in rows[0]}
    try:
        return read_trials(columns)
    except FingerflowError as error:
        raise FingerflowError(f"{location}: {error}") from None


def _typed(path: Path, name: str, cells: list[str]) -> NDArray[Any]:
    if name in _NAMES:
        return np.array(cells)
    if name == "answer":
        for number, cell in enumerate(cells, start=2):
            if cell.lower() not in ANSWERS:
                raise FingerflowError(
                    f"{path}, row {number}: answer is {cell!r}; give 1 where it was correct, 0 where not"
                )
        return np.array([ANSWERS[cell.lower()] for cell in cells])
    numbers = []
    for number, cell in enumerate(cells, start=2):
        try:
            numbers.append(math.nan if cell.lower() in NOTHING else float(cell))
        except ValueError:
            if name == "condition":
                return np.array(cells)
            raise FingerflowError(
                f"{path}, row {number}: {name} is {cell!r}; give a number, or nothing where there is none"
            ) from None
    return np.array(numbers)
