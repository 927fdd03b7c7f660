"""Ideal observer: how well a trial's metric predicts what participants felt (Willemet et al. 2021, supplement)."""

from fingerflow.models.observer.anova import Anova as Anova
from fingerflow.models.observer.anova import one_way_anova as one_way_anova
from fingerflow.models.observer.anova import repeated_anova as repeated_anova
from fingerflow.models.observer.discrimination import auc as auc
from fingerflow.models.observer.discrimination import compare_auc as compare_auc
from fingerflow.models.observer.discrimination import criterion_for_hits as criterion_for_hits
from fingerflow.models.observer.discrimination import d_prime as d_prime
from fingerflow.models.observer.discrimination import observe as observe
from fingerflow.models.observer.discrimination import permutation_p as permutation_p
from fingerflow.models.observer.estimate import Estimate as Estimate
from fingerflow.models.observer.groups import Groups as Groups
from fingerflow.models.observer.groups import participant_groups as participant_groups
from fingerflow.models.observer.printed import PrintedObserver as PrintedObserver
from fingerflow.models.observer.printed import printed_observer as printed_observer
from fingerflow.models.observer.psychometric import FORCED_CHOICE as FORCED_CHOICE
from fingerflow.models.observer.psychometric import GUESSES as GUESSES
from fingerflow.models.observer.psychometric import YES_NO as YES_NO
from fingerflow.models.observer.psychometric import PsychometricFit as PsychometricFit
from fingerflow.models.observer.psychometric import fit_psychometric as fit_psychometric
from fingerflow.models.observer.relations import clustered_regression as clustered_regression
from fingerflow.models.observer.relations import pearson as pearson
from fingerflow.models.observer.relations import spearman as spearman
from fingerflow.models.observer.trials_table import Trials as Trials
from fingerflow.models.observer.trials_table import leave_out_moved as leave_out_moved
from fingerflow.models.observer.trials_table import read_trials as read_trials
