"""Ideal observer: how well a trial's metric predicts what participants felt (Willemet et al. 2021, supplement)."""

from fingerflow.models.observer.anova import Anova, one_way_anova, repeated_anova
from fingerflow.models.observer.discrimination import (
    auc,
    compare_auc,
    criterion_for_hits,
    d_prime,
    observe,
    permutation_p,
    share_above,
)
from fingerflow.models.observer.estimate import Estimate
from fingerflow.models.observer.groups import Groups, participant_groups
from fingerflow.models.observer.printed import PrintedObserver, printed_observer
from fingerflow.models.observer.psychometric import FORCED_CHOICE, GUESSES, YES_NO, PsychometricFit, fit_psychometric
from fingerflow.models.observer.relations import clustered_regression, pearson, spearman
from fingerflow.models.observer.trials_table import Trials, leave_out_moved, read_trials

__all__ = [
    "FORCED_CHOICE", "GUESSES", "YES_NO", "Anova", "Estimate", "Groups", "PrintedObserver", "PsychometricFit", "Trials",
    "auc", "clustered_regression", "compare_auc", "criterion_for_hits", "d_prime", "fit_psychometric",
    "leave_out_moved", "observe", "one_way_anova", "participant_groups", "pearson", "permutation_p", "printed_observer",
    "read_trials", "repeated_anova", "share_above", "spearman",
]  # fmt: skip
