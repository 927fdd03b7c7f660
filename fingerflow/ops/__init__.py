"""Tensor operations (ops) on batches of frames or points: pure functions, independent of the application to fingers."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from fingerflow.ops.full_precision import without_autocast

if TYPE_CHECKING:
    from fingerflow.ops.contact.otsu import otsu_threshold as otsu_threshold
    from fingerflow.ops.fields.gridding import scattered_to_grid as scattered_to_grid
    from fingerflow.ops.fields.local_fit import local_gradients as local_gradients
    from fingerflow.ops.fields.strain import curl as curl
    from fingerflow.ops.fields.strain import divergence as divergence
    from fingerflow.ops.fields.strain import green_lagrange as green_lagrange
    from fingerflow.ops.fields.strain import strain_energy_density as strain_energy_density
    from fingerflow.ops.fields.triangles import triangle_gradients as triangle_gradients
    from fingerflow.ops.filters.illumination import normalize_illumination as normalize_illumination
    from fingerflow.ops.filters.median import median_filter as median_filter
    from fingerflow.ops.flow.dense_flow import dense_flow as dense_flow
    from fingerflow.ops.tracking.corners import detect_corners as detect_corners
    from fingerflow.ops.tracking.track_points import track_points as track_points

_HOMES = {
    "curl": "fields.strain",
    "dense_flow": "flow.dense_flow",
    "detect_corners": "tracking.corners",
    "divergence": "fields.strain",
    "green_lagrange": "fields.strain",
    "local_gradients": "fields.local_fit",
    "median_filter": "filters.median",
    "normalize_illumination": "filters.illumination",
    "otsu_threshold": "contact.otsu",
    "scattered_to_grid": "fields.gridding",
    "strain_energy_density": "fields.strain",
    "track_points": "tracking.track_points",
    "triangle_gradients": "fields.triangles",
}

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    """Return the op called `name`, and import the module that defines the op on first use."""
    if name in _HOMES:
        op = without_autocast(getattr(import_module(f"fingerflow.ops.{_HOMES[name]}"), name))
        op.__module__ = __name__  # where pickle finds it
        return globals().setdefault(name, op)
    raise AttributeError(f"module 'fingerflow.ops' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
