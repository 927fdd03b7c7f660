"""The ideal observer: how well a metric of a trial tells what participants felt (Willemet et al. 2021, supplement)."""

from fingerflow.models.observer.discrimination import auc, criterion_for_hits, d_prime, z_roc_slope
from fingerflow.models.observer.estimate import Estimate

__all__ = ["Estimate", "auc", "criterion_for_hits", "d_prime", "z_roc_slope"]
