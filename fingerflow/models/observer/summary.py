"""Comparison of all metrics in a table of trials by how well each predicts the participants' answers."""

from collections.abc import Sequence
from dataclasses import dataclass

from fingerflow.models.observer.discrimination import auc, criterion_for_hits, d_prime
from fingerflow.models.observer.estimate import Estimate
from fingerflow.models.observer.permutation import PermutationTest, permutation_test
from fingerflow.models.observer.printed import PrintedObserver, printed_observer
from fingerflow.models.observer.trials_table import Trials


@dataclass(frozen=True)
class MetricSummary:
    """Ideal-observer statistics of one metric, with confidence intervals; `printed` has them as in the paper."""

    d_prime: Estimate
    auc: Estimate
    criterion: Estimate
    permutation: PermutationTest
    printed: PrintedObserver


def observe(
    trials: Trials,
    metrics: Sequence[str] | None = None,
    hits: float = 0.75,
    level: float = 0.95,
    resamples: int = 2000,
    seed: int = 0,
) -> dict[str, MetricSummary]:
    """Compute how well each metric of a table of trials separates correct from incorrect trials: d', area under the
    ROC, criterion and permutation test, by metric name (ideal observer, Willemet et al. 2021).

    Args:
        trials: of `read_trials`, after `leave_out_moved` where trials of fingers that slid are to be left out.
        metrics: names; all where None.
        hits: share of correct trials above the criterion.
        level, resamples, seed: of the intervals, resampled by participant, and of the permutations.

    Raises:
        FingerflowError: a metric that the table does not have.
    """
    who = trials.participants()
    found = {}
    for name in trials.metrics if metrics is None else metrics:
        correct, incorrect = trials.split(name)
        found[name] = MetricSummary(
            d_prime(correct, incorrect, participants=who, level=level, resamples=resamples, seed=seed),
            auc(correct, incorrect, participants=who, level=level, resamples=resamples, seed=seed),
            criterion_for_hits(correct, hits, participants=who[0], level=level, resamples=resamples, seed=seed),
            permutation_test(correct, incorrect, participants=who, permutations=resamples, seed=seed),
            printed_observer(correct, incorrect, hits),
        )
    return found
