"""Partial slip of a fingertip under a tangential load (Terekhov & Hayward 2011): model, fit, verdict of a trial."""

from fingerflow.models.partial_slip.comparison import CurveComparison, CurveScore, compare_curves
from fingerflow.models.partial_slip.evolution import (
    critical_load_ratio,
    critical_stuck_area,
    friction_ratio,
    load_ratio,
    stuck_area,
)
from fingerflow.models.partial_slip.fit import FrictionFit, fit_friction
from fingerflow.models.partial_slip.verdict import TrialVerdict, judge_trial

__all__ = [
    "CurveComparison", "CurveScore", "FrictionFit", "TrialVerdict", "compare_curves", "critical_load_ratio",
    "critical_stuck_area", "fit_friction", "friction_ratio", "judge_trial", "load_ratio", "stuck_area",
]  # fmt: skip
