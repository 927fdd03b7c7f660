"""Table of all columns in a force file, as every reader of force files returns it."""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


@dataclass
class ForceTable:
    """Table of all columns of a force file with the values as stored, before force channels are selected and converted.

    `units` by column, if the file states them; `sample_rate` (Hz) and `start` (s) if it states a rate; `clocks`:
    (sample interval, time of the first sample), s, of columns that state their own; `warnings`: sentences for the user.
    """

    path: Path
    columns: dict[str, NDArray[np.float64]]
    units: dict[str, str] = field(default_factory=dict)
    sample_rate: float | None = None
    start: float = 0.0
    clocks: dict[str, tuple[float, float]] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)

    def add(self, name: str, values: NDArray[np.float64], unit: object = None) -> None:
        """Add a column (n,), or the k columns of a matrix (n, k), named name[0] to name[k - 1], to the table; `unit` is
        None if unknown.
        """
        values = np.squeeze(np.asarray(values, np.float64))
        added = {name: values} if values.ndim == 1 else {}
        if values.ndim == 2:
            long = values if values.shape[0] >= values.shape[1] else values.T
            added = {f"{name}[{number}]": column for number, column in enumerate(long.T)}
        self.columns |= added
        if unit is not None:
            self.units |= dict.fromkeys(added, str(unit))


def split_unit(heading: str) -> tuple[str, str | None]:
    """Split a column heading into name and unit, for example 'normal_force (mN)' into 'normal_force' and 'mN'."""
    match = re.fullmatch(r"(.*?)\s*[(\[]\s*([^()\[\]]*?)\s*[)\]]\s*", heading)
    return (match.group(1).strip(), match.group(2)) if match and match.group(1) else (heading.strip(), None)
