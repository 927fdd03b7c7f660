"""Statistics of the paper from a table of trials, by `fingerflow.models.observer`, and counts of excluded trials."""

import warnings
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from fingerflow.errors import FingerflowError
from fingerflow.models.observer import (
    Trials,
    compare_auc,
    leave_out_moved,
    mixed_model,
    observe,
    one_way_anova,
    participant_groups,
    pearson,
    read_trials,
    spearman,
)
from fingerflow.report.trial_metrics import METRICS, dots_of, participant_medians
from fingerflow.schema.json_value import json_value
from fingerflow.schema.trial_columns import NUMBERS
from fingerflow.study.trial_files import MEASURED

_FIRST = "divergence"  # the metric that the others are compared with


@dataclass(frozen=True)
class Counted:
    """Number of trials of a study, of those that each rule excludes, and of those used."""

    trials: int
    rules: tuple[tuple[str, int], ...]
    used: int


@dataclass(frozen=True)
class Sample:
    """Trials that figures and statistics use; if `answered` is False, no answers exist and `answer` is meaningless."""

    trials: Trials
    answered: bool
    counted: Counted


def sample_of(frame: Any) -> Sample:
    """Select the trials of a table (a DataFrame with the columns of `write_tables`) that statistics can use.

    Raises FingerflowError if no trial has been measured.
    """
    measured = (frame["status"] == MEASURED).to_numpy()
    answered = frame["answer"].notna().to_numpy()
    any_answer = bool((measured & answered).any())
    used = measured & answered if any_answer else measured
    if not used.any():
        raise FingerflowError("no trial has been measured: `fingerflow study run` comes first, and says what failed")
    own = frame[used]
    columns = {name: own[name].to_numpy() for name in ("participant", "trial", "condition")}
    columns["answer"] = own["answer"].to_numpy().astype(bool) if any_answer else np.zeros(len(own), bool)
    metrics = {name: own[name].to_numpy(np.float64) for name in METRICS if name in own and own[name].notna().any()}
    rules = [(f"{name}, so nothing was measured", int((frame["status"] == name).sum()))
             for name in dict.fromkeys(frame["status"]) if name != MEASURED]  # fmt: skip
    if any_answer:
        rules.append(("no answer in the manifest", int((measured & ~answered).sum())))
    return Sample(read_trials(columns | metrics), any_answer, Counted(len(frame), tuple(rules), int(used.sum())))


def statistics_of(sample: Sample, resamples: int = 2000) -> dict[str, Any]:
    """Compute all statistics as plain numbers, for `statistics.json` and the page.

    - `counted`: numbers of trials, left out by each rule and used.
    - `by_condition`, `by_answer`: a one-way ANOVA of each metric over conditions and over answers.
    - `shares`: Spearman's coefficient between medians and shares of answers, one dot per participant and condition.
    - `correlations`: Pearson's, of strain, strain energy and curl with divergence.
    - `force_rate`: a mixed model of the rate by condition, one intercept per participant (needs numeric conditions).
    - `observer`: d', area under the ROC, criterion for 75 % hits, and their intervals by participant, without trials of
      fingers that slid as a whole; `beside_divergence` is the area minus that of divergence in the same trials.
    - `groups`: one or two groups of participants by their median divergence.

    `by_answer`, `shares` and `observer` exist only with answers.

    Args:
        sample: of `sample_of`.
        resamples: of intervals and tests.
    """
    trials = sample.trials
    found: dict[str, Any] = {
        "counted": asdict(sample.counted),
        "by_condition": {name: one_way_anova(values, trials.condition) for name, values in trials.metrics.items()},
        "correlations": {
            name: pearson(trials.metrics[_FIRST], trials.metrics[name])
            for name in ("strain", "strain_energy", "curl")
            if name in trials.metrics and _FIRST in trials.metrics
        },
        "force_rate": _of_force_rate(trials),
        "groups": _groups(trials, resamples),
    }
    if sample.answered:
        found["by_answer"] = {name: one_way_anova(values, trials.answer) for name, values in trials.metrics.items()}
        found["shares"] = {name: spearman(*dots_of(trials, values)[:2]) for name, values in trials.metrics.items()}
        found["observer"] = _observed(trials, resamples)
    plain: dict[str, Any] = json_value(found)
    return plain


def _observed(trials: Trials, resamples: int) -> dict[str, Any]:
    without = leave_out_moved(trials) if "global_displacement" in trials.metrics else trials
    found = {}
    first = without.split(_FIRST) if _FIRST in without.metrics else None
    for name, summary in observe(without, resamples=resamples).items():
        found[name] = {
            "d_prime": summary.d_prime,
            "auc": summary.auc,
            "criterion": summary.criterion,
            "permutation": summary.permutation,
            "as_printed": {"d_prime": summary.printed.d_prime, "auc": summary.printed.auc},
        }
        if first is not None and name != _FIRST:
            found[name]["beside_divergence"] = compare_auc(
                without.split(name), first, participants=without.participants(), resamples=resamples
            )
    return {"left_out": without.left_out, "rule": without.rule, "metrics": found}


def _of_force_rate(trials: Trials) -> Any:
    if "force_rate" not in trials.metrics or not np.issubdtype(trials.condition.dtype, np.number):
        return {"reason": "needs the rate of the force and conditions that are numbers"}
    table = {
        "participant": trials.participant,
        "condition": trials.condition.astype(float),
        "force_rate": trials.metrics["force_rate"],
    }
    try:
        with warnings.catch_warnings(record=True):  # the result reports whether it converged
            return mixed_model(table, "force_rate ~ condition")
    except (FingerflowError, ValueError, np.linalg.LinAlgError) as error:
        return {"reason": f"the model cannot be fitted: {error}"}


def _groups(trials: Trials, resamples: int) -> Any:
    if _FIRST not in trials.metrics:
        return {"reason": "needs the divergence"}
    names, medians = participant_medians(trials, _FIRST)
    groups = participant_groups(medians, resamples)
    return {**asdict(groups), "names": names, "medians": medians, "unit": NUMBERS[_FIRST].shown_unit.name}
