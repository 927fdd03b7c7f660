"""What a reader of force files hands over: columns as they stand in the file, before any of them is chosen."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


@dataclass
class ForceTable:
    """`units` by column, where the file states them; `sample_rate` (Hz) and `start` (s) where it states a rate;
    `warnings`: what a user should read.
    """

    path: Path
    columns: dict[str, NDArray[np.float64]]
    units: dict[str, str] = field(default_factory=dict)
    sample_rate: float | None = None
    start: float = 0.0
    warnings: list[str] = field(default_factory=list)

    def add(self, name: str, values: NDArray[np.float64]) -> None:
        """Take one column, or a matrix (n, k) as the columns name[0] .. name[k - 1]."""
        values = np.squeeze(np.asarray(values, np.float64))
        if values.ndim == 1:
            self.columns[name] = values
        elif values.ndim == 2:
            for number, column in enumerate(values.T if values.shape[0] >= values.shape[1] else values):
                self.columns[f"{name}[{number}]"] = column


def split_unit(heading: str) -> tuple[str, str | None]:
    """'normal_force (mN)' and 'normal_force [mN]' are the column normal_force in mN."""
    match = re.fullmatch(r"(.*?)\s*[(\[]\s*([^()\[\]]*?)\s*[)\]]\s*", heading)
    return (match.group(1).strip(), match.group(2)) if match and match.group(1) else (heading.strip(), None)
