"""Table of trials: one row per trial with participant, condition, answer and metrics."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fingerflow.errors import FingerflowError

Values = NDArray[np.float64]

COLUMNS = ("participant", "trial", "condition", "answer")
# Columns that measure the sideways motion of the finger itself, so `leave_out_moved` keeps them.
_OF_MOTION = ("global_displacement", "force_angle")
MOVED_MM = 0.2  # displacement above which a finger has slid as a whole


@dataclass(frozen=True)
class Trials:
    """Table of T trials: participant, trial, condition, whether the answer was correct, and metrics by name, (T,) each.

    `left_out` counts the trials whose metrics a rule has set to NaN; `rule` describes it.
    """

    participant: NDArray[Any]
    trial: NDArray[Any]
    condition: NDArray[Any]
    answer: NDArray[np.bool_]
    metrics: dict[str, Values]
    left_out: int = 0
    rule: str = ""

    def split(self, metric: str) -> tuple[Values, Values]:
        """Return a metric's values in the correct and in the incorrect trials, NaN included; raise FingerflowError if
        the table has no metric of this name.
        """
        if metric not in self.metrics:
            raise FingerflowError(f"the table has no metric {metric!r}: it has {', '.join(self.metrics)}")
        return self.metrics[metric][self.answer], self.metrics[metric][~self.answer]

    def participants(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the participant of each correct trial and of each incorrect trial."""
        return self.participant[self.answer], self.participant[~self.answer]


def read_trials(table: Mapping[str, ArrayLike]) -> Trials:
    """Convert a tidy table to `Trials` after checking it: a pandas DataFrame, or a mapping of equally long columns.

    Args:
        table: columns `participant`, `trial`, `condition`, `answer` (True or 1 where correct, False or 0 where not) and
            any number of metrics, numbers with NaN where one was not measured.

    Raises:
        FingerflowError: a column is missing or of another length, a trial occurs twice, an answer is neither, or a
            metric is not numeric or infinite; names the column, the value and the remedy.
    """
    names = [str(name) for name in table.keys()]  # noqa: SIM118 - a DataFrame iterates over its columns by keys alone
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        raise FingerflowError(f"the table of trials lacks {', '.join(missing)}: it has {', '.join(names)}")
    columns = {name: np.asarray(table[name]) for name in names}
    length = columns["participant"].shape
    for name, column in columns.items():
        if column.shape != length or column.ndim != 1:
            raise FingerflowError(
                f"column {name!r} has shape {column.shape}, participant {length}: give one value a trial"
            )
    answer = columns["answer"]
    valid = np.isin(answer, (0, 1))  # also accepts True and False
    if not valid.all():
        raise FingerflowError(
            f"an answer is {answer[~valid].tolist()[0]!r}: give True where it was correct, False where not"
        )
    who, which, condition = (columns[name] for name in COLUMNS[:3])
    keys = list(zip(who.tolist(), which.tolist(), condition.tolist(), strict=True))
    if len(set(keys)) < len(keys):
        twice = next(key for key in keys if keys.count(key) > 1)
        raise FingerflowError(
            f"trial {twice[1]} of participant {twice[0]}, condition {twice[2]}, is in the table twice: leave one out"
        )
    metrics = {name: _numbers(name, column) for name, column in columns.items() if name not in COLUMNS}
    return Trials(who, which, condition, answer.astype(bool), metrics)


def leave_out_moved(trials: Trials) -> Trials:
    """Set metrics to NaN in trials whose finger slid as a whole (`global_displacement` above 0.2 mm or unknown).

    Willemet et al. 2021 ask in this way what other cues tell without that one. The displacement and the force angle
    stay.

    Raises:
        FingerflowError: the table has no `global_displacement`.
    """
    if "global_displacement" not in trials.metrics:
        raise FingerflowError("the table has no global_displacement (mm): trials cannot be left out by it")
    with np.errstate(invalid="ignore"):
        out = ~(trials.metrics["global_displacement"] <= MOVED_MM)
    metrics = {
        name: values if name in _OF_MOTION else np.where(out, np.nan, values) for name, values in trials.metrics.items()
    }
    rule = f"global displacement above {MOVED_MM:g} mm, or not known"
    return Trials(trials.participant, trials.trial, trials.condition, trials.answer, metrics, int(out.sum()), rule)


def _numbers(name: str, column: NDArray[Any]) -> Values:
    try:
        values = column.astype(np.float64)
    except (TypeError, ValueError):
        raise FingerflowError(f"metric {name!r} is not of numbers: leave it out, or mark its gaps with NaN") from None
    if np.isinf(values).any():
        raise FingerflowError(f"metric {name!r} is infinite in trial {np.flatnonzero(np.isinf(values))[0]}: give NaN")
    return values
