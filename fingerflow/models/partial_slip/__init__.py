"""Partial slip of a fingertip under a tangential load (Terekhov & Hayward 2011): model, fit and verdict of a trial."""

from fingerflow.models.partial_slip.evolution import (
    critical_load_ratio,
    critical_stuck_area,
    friction_ratio,
    load_ratio,
    stuck_area,
)
from fingerflow.models.partial_slip.other_curves import coulomb_stuck_area, equal_friction_stuck_area, tada_stuck_area
from fingerflow.models.partial_slip.traction import pressure, traction

__all__ = [
    "coulomb_stuck_area",
    "critical_load_ratio",
    "critical_stuck_area",
    "equal_friction_stuck_area",
    "friction_ratio",
    "load_ratio",
    "pressure",
    "stuck_area",
    "tada_stuck_area",
    "traction",
]
