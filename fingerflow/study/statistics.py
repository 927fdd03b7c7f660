"""Compute the statistics of Willemet et al. 2021 from a table of trials, with counts of the excluded trials."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.models import observer
from fingerflow.report.trial_metrics import METRICS, participant_dots, participant_medians
from fingerflow.schema.json_value import json_value
from fingerflow.schema.trial_columns import DIFFERENCE, NUMBERS
from fingerflow.study.manifest import REFERENCE
from fingerflow.study.trial_files import MEASURED

_FIRST = "divergence"  # the metric with which the others are compared
_LARGEST_AMPLITUDE = 2.0  # µm, largest amplitude at which the paper asks whether the force rate changes answers


@dataclass(frozen=True)
class Sample:
    """Trials used in figures and statistics, of `number` trials of the study, and how many each rule excludes, as pairs
    (rule in words, number); `table` is a DataFrame with their rows.

    If `answered` is False, the study has no answers, and `trials.answer` holds placeholders (False).
    """

    trials: observer.Trials
    table: Any
    answered: bool
    number: int
    rules: tuple[tuple[str, int], ...]

    @property
    def used(self) -> int:
        """Return the number of trials that are used."""
        return len(self.trials.answer)


def read_sample(frame: Any) -> Sample:
    """Select the trials of a table that statistics can use: measured and, if the study has answers, answered.

    `frame` is a DataFrame with the columns of `write_tables`.

    Raises FingerflowError if no trial has been measured.
    """
    measured = (frame["status"] == MEASURED).to_numpy()
    answered = frame["answer"].notna().to_numpy()
    any_answer = bool((measured & answered).any())
    used = measured & answered if any_answer else measured
    if not used.any():
        raise FingerflowError("no trial has been measured: `fingerflow study run` comes first, and says what failed")
    rows = frame[used]
    columns = {name: rows[name].to_numpy() for name in ("participant", "trial", "condition")}
    columns["answer"] = rows["answer"].to_numpy().astype(bool) if any_answer else np.zeros(len(rows), bool)
    names = (*METRICS, *(f"{name}{DIFFERENCE}" for name in METRICS))
    metrics = {name: rows[name].to_numpy(np.float64) for name in names if name in rows and rows[name].notna().any()}
    rules = [(f"{name}, so nothing was measured", int((frame["status"] == name).sum()))
             for name in dict.fromkeys(frame["status"]) if name != MEASURED]  # fmt: skip
    if any_answer:
        # A reference press is no question: its numbers count in the differences of the presses compared with it.
        named = set(zip(frame["participant"], frame[REFERENCE], strict=True)) if REFERENCE in frame else set()
        reference = np.array([pair in named for pair in zip(frame["participant"], frame["trial"], strict=True)])
        silent = measured & ~answered
        rules.append(("no answer in the manifest", int((silent & ~reference).sum())))
        rules.append(("reference presses, which count in differences from them", int((silent & reference).sum())))
    return Sample(observer.read_trials(columns | metrics), rows, any_answer, len(frame), tuple(rules))


def study_statistics(sample: Sample, resamples: int = 2000) -> dict[str, Any]:
    """Compute all statistics of the trials in `sample` as plain numbers, for `statistics.json` and the HTML report of a
    study.

    - `counted`: numbers of trials, left out by each rule and used.
    - `by_condition`, `by_answer`: an ANOVA of each metric over conditions and over answers, participants being random;
      `as_printed` is the one-way ANOVA of the paper, which takes trials as independent.
    - `shares`: Spearman's coefficient between medians and shares of answers, one dot per participant and condition.
    - `correlations`: Pearson's, of strain, strain energy and curl with divergence.
    - `force_rate`: the regression of the answer by the rate at amplitudes up to 2 µm (needs numeric conditions).
    - `observer`: d', area under the ROC, criterion for 75 % hits in `unit`, its false alarms, and their intervals by
      participant, in the trials that have all metrics and no finger that slid as a whole; `beside_divergence` is the
      area minus that of divergence.
    - `groups`: one or two groups of participants by their median divergence, or its difference.

    Differences of a comparison from its reference are in `shares` and `groups` alone. Participants are the units of
    every interval and p. `p_holm` is p corrected for the metrics of its table (Holm 1979). `by_answer`, `shares`,
    `force_rate` and `observer` exist only with answers.

    Args:
        sample: of `read_sample`.
        resamples: of tests.
    """
    differences = sample.trials
    values = {name: values for name, values in differences.metrics.items() if not name.endswith(DIFFERENCE)}
    trials = replace(differences, metrics=values)
    related = [name for name in ("strain", "strain_energy", "curl") if values.keys() >= {name, _FIRST}]
    correlations = {name: observer.pearson(values[_FIRST], values[name], trials.participant) for name in related}
    statistics = {
        "counted": {"trials": sample.number, "rules": sample.rules, "used": sample.used},
        "by_condition": _anovas(trials, trials.condition),
        "correlations": _corrected(correlations),
        "groups": _groups(differences, resamples),
    }
    if sample.answered:
        statistics["by_answer"] = _anovas(trials, trials.answer)
        shares = {name: correlate_with_answers(trials, values) for name, values in differences.metrics.items()}
        statistics["shares"] = _corrected(shares)
        statistics["force_rate"] = _force_rate_rows(trials)
        statistics["observer"] = _observed(trials, resamples)
    return json_value(statistics)


def holm(p: Mapping[str, float]) -> dict[str, float]:
    """Return p-values corrected for multiple tests by Holm's method.

    The chance that any of m true null hypotheses has a corrected p below alpha is at most alpha (Holm 1979). NaN
    stays, and does not count.
    """
    from statsmodels.stats.multitest import multipletests

    finite = {name: value for name, value in p.items() if np.isfinite(value)}
    corrected = multipletests(list(finite.values()), method="holm")[1].tolist() if finite else []
    return dict(p) | dict(zip(finite, corrected, strict=True))


def _corrected(tests: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return several statistical tests as dictionaries, each with its Holm-corrected p-value `p_holm`."""
    corrected = holm({name: test.p for name, test in tests.items()})
    return {name: {**asdict(test), "p_holm": corrected[name]} for name, test in tests.items()}


def _anovas(trials: observer.Trials, groups: NDArray[Any]) -> dict[str, dict[str, Any]]:
    who, metrics = trials.participant, trials.metrics
    tests = _corrected({name: observer.repeated_anova(values, groups, who) for name, values in metrics.items()})
    for name, values in metrics.items():
        tests[name]["as_printed"] = asdict(observer.one_way_anova(values, groups))
    return tests


def _observed(trials: observer.Trials, resamples: int) -> dict[str, Any]:
    without = observer.leave_out_moved(trials) if "global_displacement" in trials.metrics else trials
    shown = {name: NUMBERS[name].shown_values(values) for name, values in without.metrics.items()}
    summaries = observer.observe(replace(without, metrics=shown), permutations=resamples)
    areas = _corrected({name: summary.auc for name, summary in summaries.items()})
    metrics = {}
    first = (without.split(_FIRST), without.participants()) if _FIRST in without.metrics else None
    for name, summary in summaries.items():
        metrics[name] = {
            "d_prime": summary.d_prime,
            "auc": areas[name],
            "criterion": {**asdict(summary.criterion), "unit": NUMBERS[name].shown_unit.name},
            "false_alarms": summary.false_alarms,
            "as_printed": {"d_prime": summary.printed.d_prime, "auc": summary.printed.auc},
        }
        if first is not None and name != _FIRST:
            metrics[name]["beside_divergence"] = observer.compare_auc(without.split(name), *first)
    return {"left_out": without.left_out, "rule": without.rule, "metrics": metrics}


def correlate_with_answers(trials: observer.Trials, values: NDArray[np.float64]) -> observer.Estimate:
    """Compute Spearman's rank correlation between a metric (T,), one value per trial, and the share of "more slippery"
    answers, over all pairs of participant and condition.

    Each pair of values is the median metric and the share of one participant in one condition.
    """
    medians, shares, _, who = participant_dots(trials, values)
    return observer.spearman(medians, shares, who)


def _force_rate_rows(trials: observer.Trials) -> Any:
    if "force_rate" not in trials.metrics or not np.issubdtype(trials.condition.dtype, np.number):
        return {"reason": "needs the rate of the force and conditions that are numbers"}
    small = trials.condition <= _LARGEST_AMPLITUDE
    rate, unit = trials.metrics["force_rate"], NUMBERS["force_rate"].shown_unit.name
    columns = rate, trials.answer, trials.condition, trials.participant
    regression = observer.clustered_regression(*(column[small] for column in columns))
    return {**asdict(regression), "unit": f"per {unit}", "largest_amplitude_um": _LARGEST_AMPLITUDE}


def _groups(trials: observer.Trials, resamples: int) -> Any:
    if _FIRST not in trials.metrics:
        return {"reason": "needs the divergence"}
    metric = f"{_FIRST}{DIFFERENCE}" if f"{_FIRST}{DIFFERENCE}" in trials.metrics else _FIRST
    names, medians = participant_medians(trials, metric)
    groups = observer.participant_groups(medians, resamples)
    return {**asdict(groups), "names": names, "medians": medians, "unit": NUMBERS[_FIRST].shown_unit.name}
